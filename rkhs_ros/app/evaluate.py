"""``rkhs evaluate``: measure a policy in noise-free episodes."""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import numpy as np
from scipy import stats

from rkhs_ros.app.inline import load_acting
from rkhs_ros.base.validation import require
from rkhs_ros.policies.streams import Batch
from rkhs_ros.rkhs.kernels import Array

CONFIDENCE = 0.95


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    parser.add_argument("policy", type=Path, metavar="DIR|FILE", help="a run's folder, or a policy file")
    parser.add_argument("--episodes", type=int, default=100, metavar="N", help="number of episodes (%(default)s)")
    parser.add_argument("--seed", type=int, default=0, metavar="N", help="seed of all randomness (%(default)s)")
    parser.add_argument("--discount", type=float, metavar="D", help="discount factor of the return (the task's)")


def run(options: argparse.Namespace) -> int:
    """Print the discounted and the undiscounted return as JSON."""
    require(options.episodes >= 1, "--episodes", "at least 1", options.episodes)
    policy, task, runner = load_acting(options.policy)
    discount = task.discount if options.discount is None else options.discount
    require(0.0 <= discount <= 1.0, "--discount", "a number in [0, 1]", discount)
    episodes = runner.collect(policy, Batch(options.seed, 0, options.episodes, task.horizon, explore=False))
    result = {
        "environment": task.environment,
        "episodes": options.episodes,
        "seed": options.seed,
        "discount": discount,
        **_measured(episodes.returns(discount)),
        "undiscounted": _measured(episodes.returns(1.0)),
    }
    print(json.dumps(result, indent=2))
    return 0


def _measured(returns: Array) -> dict[str, object]:
    """Return mean, standard deviation, and Student's t interval of the mean; of one episode there is none."""
    mean, interval = float(returns.mean()), None
    if len(returns) > 1:
        half = float(stats.t.ppf(0.5 + CONFIDENCE / 2, len(returns) - 1) * stats.sem(returns))
        interval = [mean - half, mean + half]
    return {"mean": mean, "sd": float(np.std(returns)), "interval_95": interval}
