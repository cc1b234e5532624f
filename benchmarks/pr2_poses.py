"""At how many of 100 unseen poses the PR2 opens the door after `pr2_door_contextual`'s 150 episodes, by seed.

``python benchmarks/pr2_poses.py [SEED ...]``, the seeds 3 to 8 if none are given; about 20 s a seed.
"""

from __future__ import annotations

import os
import sys
from pathlib import Path

os.environ["OMP_NUM_THREADS"] = "1"

import numpy as np

from rkhs_ros.learning.training import train
from rkhs_ros.policies.streams import Batch
from rkhs_ros.runs.config import load_config
from rkhs_ros.runs.rollout import InlineRunner
from rkhs_ros.runs.simulation import Simulation
from sim_nodes.pr2.environment import PR2Door

CONFIG = Path(__file__).parents[1] / "config" / "pr2_door_contextual.yaml"
SEEDS = (3, 4, 5, 6, 7, 8)
UNSEEN = Batch(777, 0, 100, 1, explore=False)  # its seed is that of no run


def opened(seed: int) -> int:
    """Learn from a seed and return how many doors the policy opens."""
    config = load_config(CONFIG, [f"seed={seed}", "evaluate_every=0"])
    runner = InlineRunner(Simulation(config.environment.id, config.environment.options))
    *_, last = train(config.training, runner)
    rewards = runner.collect(last.policy, UNSEEN).rewards[:, 0]
    return int((rewards > PR2Door.success_reward).sum())


def main(seeds: tuple[int, ...]) -> None:
    """Print a line for each seed, and the median."""
    counts = []
    for seed in seeds:
        counts.append(opened(seed))
        print(f"seed {seed}: {counts[-1]} of {UNSEEN.rows}", flush=True)
    print(f"median {np.median(counts):g} (aim 90), least {min(counts)} (aim 80)")


if __name__ == "__main__":
    main(tuple(map(int, sys.argv[1:])) or SEEDS)
