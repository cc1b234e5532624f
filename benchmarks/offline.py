"""Train a pendulum offline, from recordings of exploration episodes, and print the evaluation return per seed."""

from __future__ import annotations

import tempfile
import time
from dataclasses import replace
from pathlib import Path

import numpy as np

from command import parsed, parser
from rkhs_ros.app.inline import runner_of
from rkhs_ros.app.seeds import parse_seeds
from rkhs_ros.base.threads import one_thread
from rkhs_ros.policies.streams import Batch
from rkhs_ros.recordings.recording import read_recording
from rkhs_ros.runs.config import Config, load_config
from rkhs_ros.runs.offline import all_episodes, learn_offline
from rkhs_ros.runs.run import run_training

ROOT = Path(__file__).parents[1]
GOAL, BEST = 45.0, 51.8  # evaluation returns: the aim, and the best possible
TEST_EPISODES, TEST_SEED = 100, 10**6


@one_thread()
def main() -> None:
    """Record exploration episodes, train from the recording, and print the returns."""
    command = parser(__doc__)
    command.add_argument("--episodes", type=int, nargs="+", default=[10, 20])
    command.add_argument("--seeds", default="100-109", help="such as 100-109 or 100,105; the default is held out")
    command.add_argument("--config", default="pendulum_model_nac")
    command.add_argument("--rounds", type=int, default=3)
    options = parsed(command, config="toy_model_nac", episodes=[2], seeds="100", rounds=1)
    seeds = parse_seeds(options.seeds)
    for episodes in options.episodes:
        returns = []
        for seed in seeds:
            begin = time.perf_counter()
            returns.append(_return(options.config, episodes, seed, options.rounds))
            print(f"seed {seed}: {returns[-1]:.1f} ({time.perf_counter() - begin:.0f} s)", flush=True)
        reached = np.mean([value >= GOAL for value in returns])
        print(
            f"{options.config}, {episodes} recorded episodes: {reached:.0%} of {len(seeds)} seeds reach {GOAL:g} of "
            f"{BEST:g}; median {np.median(returns):.1f}, least {min(returns):.1f}"
        )


def _return(name: str, episodes: int, seed: int, rounds: int) -> float:
    """Return the return of a policy trained on recorded episodes of the initial policy."""
    config = load_config(ROOT / "config" / f"{name}.yaml", [f"seed={seed}"])
    runner = runner_of(config.environment)
    with tempfile.TemporaryDirectory() as folder:
        recording = read_recording(run_training(_exploring(config, episodes), runner, Path(folder), quiet=True))
    recorded = all_episodes({"recording": recording})
    training = replace(config.training, iterations=rounds)
    *_, last = learn_offline(training, runner.spaces, recorded)
    test = Batch(TEST_SEED, 0, TEST_EPISODES, training.horizon, explore=False)
    return float(runner.collect(last.policy, test).returns(training.discount).mean())


def _exploring(config: Config, episodes: int) -> Config:
    """Return the settings of a run with one iteration, whose episodes all precede the update."""
    settings = replace(config.training.model, updates=1, rollouts=1)
    training = replace(config.training, iterations=1, episodes_per_iteration=episodes, evaluate_every=0, model=settings)
    return replace(config, training=training)


if __name__ == "__main__":
    main()
