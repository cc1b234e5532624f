"""How far rows are stepped: the environment's steps in a few iterations against the steps of the episodes."""

from __future__ import annotations

import sys
import time
from typing import Any

import gymnasium

import rkhs_ros

ENVIRONMENT, ITERATIONS = "InvertedPendulum-v5", 3


class Counting(gymnasium.Wrapper[Any, Any, Any, Any]):
    """Counts the steps of all environments that are wrapped."""

    steps = 0

    def step(self, action: Any) -> Any:
        """Count a step and make it."""
        Counting.steps += 1
        return self.env.step(action)


def main() -> None:
    """Print the steps of the rows, and those needed."""
    horizon = gymnasium.spec(ENVIRONMENT).max_episode_steps or 0
    needed, episodes, begin = 0, 0, time.perf_counter()
    for result in rkhs_ros.learn(
        lambda: Counting(gymnasium.make(ENVIRONMENT)), iterations=ITERATIONS, horizon=horizon, seed=0
    ):
        batches = (result.iteration.exploration, result.iteration.evaluation)
        needed += sum(int(batch.mask.sum()) for batch in batches)
        episodes += sum(map(len, batches))
        returns = result.iteration.train_return, result.iteration.mean_policy_return
        print(f"iteration {result.iteration.number}: return {returns[0]!r}, noise-free {returns[1]!r}")
    seconds = time.perf_counter() - begin
    print(f"{episodes} episodes of {needed} steps in all: rows stepped {Counting.steps} times in {seconds:.2f} s,")
    print(f"to the horizon it would be {episodes * horizon} times")


if __name__ == "__main__":
    try:
        main()
    except gymnasium.error.DependencyNotInstalled:
        sys.exit("error: expected MuJoCo, got none; install gymnasium[mujoco]")
