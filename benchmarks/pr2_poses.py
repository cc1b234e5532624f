"""Count the 100 unseen poses at which the PR2 opens the door after the 150 episodes of `pr2_door_contextual`.

The default seeds 50 to 69 are held out. A seed takes about 20 s.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path

os.environ["OMP_NUM_THREADS"] = "1"

import numpy as np

from command import needing, parser
from rkhs_ros.app.inline import runner_of
from rkhs_ros.learning.training import train
from rkhs_ros.policies.streams import Batch
from rkhs_ros.runs.config import load_config

with needing("pybullet", "pip install pybullet"):
    from sim_nodes.pr2.environment import PR2Door

CONFIG = Path(__file__).parents[1] / "config" / "pr2_door_contextual.yaml"
SEEDS = range(50, 70)
QUICK = ("iterations=1", "model.updates=1", "model.rollouts=5")
UNSEEN, QUICK_UNSEEN = (Batch(777, 0, poses, 1, explore=False) for poses in (100, 2))  # no run uses their seed


def opened(seed: int, unseen: Batch, changes: Sequence[str]) -> int:
    """Train with a seed and return how many doors the policy opens."""
    config = load_config(CONFIG, [f"seed={seed}", "evaluate_every=0", *changes])
    runner = runner_of(config.environment)
    *_, last = train(config.training, runner)
    rewards = runner.collect(last.policy, unseen).rewards[:, 0]
    return int((rewards > PR2Door.success_reward).sum())


def main(seeds: Sequence[int], unseen: Batch, changes: Sequence[str]) -> None:
    """Print a line for each seed, and the median."""
    counts = []
    for seed in seeds:
        counts.append(opened(seed, unseen, changes))
        print(f"seed {seed}: {counts[-1]} of {unseen.num_envs}", flush=True)
    print(f"median {np.median(counts):g} (aim 90), least {min(counts)} (aim 80)")


if __name__ == "__main__":
    command = parser(__doc__)
    command.add_argument("seeds", nargs="*", type=int, metavar="SEED", help="(50 to 69)")
    options = command.parse_args()
    quick = (SEEDS[:1], QUICK_UNSEEN, QUICK)
    main(*(quick if options.quick else (options.seeds or SEEDS, UNSEEN, ())))
