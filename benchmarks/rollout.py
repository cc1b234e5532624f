"""Compare the steps of the environments of a batch with the steps of the episodes, over a few iterations."""

from __future__ import annotations

import time
from typing import Any

import gymnasium

import rkhs_ros
from command import needing, parser

with needing("mujoco", "pip install 'gymnasium[mujoco]'"):
    import mujoco  # noqa: F401

ENVIRONMENT, ITERATIONS = "InvertedPendulum-v5", 3
QUICK = 1, 5


class Counting(gymnasium.Wrapper[Any, Any, Any, Any]):
    """Counts the steps of all wrapped environments."""

    steps = 0

    def step(self, action: Any) -> Any:
        """Count a step and run it."""
        Counting.steps += 1
        return self.env.step(action)


def main(iterations: int, horizon: int | None) -> None:
    """Print the steps of the environments and those needed, with the environment's own horizon or another."""
    horizon = horizon or gymnasium.spec(ENVIRONMENT).max_episode_steps or 0
    needed, episodes, begin = 0, 0, time.perf_counter()
    for result in rkhs_ros.learn(
        lambda: Counting(gymnasium.make(ENVIRONMENT)), iterations=iterations, horizon=horizon, seed=0
    ):
        batches = (result.iteration.exploration, result.iteration.evaluation)
        needed += sum(int(batch.mask.sum()) for batch in batches)
        episodes += sum(map(len, batches))
        returns = result.iteration.exploration_return, result.iteration.evaluation_return
        print(
            f"iteration {result.iteration.number}: exploration return {returns[0]!r}, evaluation return {returns[1]!r}"
        )
    seconds = time.perf_counter() - begin
    print(f"{episodes} episodes of {needed} steps in total: {Counting.steps} environment steps in {seconds:.2f} s;")
    print(f"with every episode run to the horizon: {episodes * horizon}")


if __name__ == "__main__":
    main(*(QUICK if parser(__doc__).parse_args().quick else (ITERATIONS, None)))
