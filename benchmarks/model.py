"""Measure a dynamics model: the time of fits at growing numbers of steps, and the steps per second of rollouts.

Time is the median over repeats on one core.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from functools import partial

os.environ["OMP_NUM_THREADS"] = "1"

import numpy as np

from command import parser
from rkhs_ros.learning.episodes import Episodes
from rkhs_ros.learning.model.dynamics_model import DynamicsModel
from rkhs_ros.learning.model.model_rollouts import ModelRunner
from rkhs_ros.policies.gaussian import GaussianPolicy
from rkhs_ros.policies.inputs import Inputs
from rkhs_ros.policies.spaces import Spaces
from rkhs_ros.policies.streams import Batch
from rkhs_ros.policies.variance import ConstantVariance
from rkhs_ros.rkhs.function import Function
from rkhs_ros.rkhs.kernels import RBF
from timing import growth, seconds_of

HORIZON, NUM_ENVS = 100, (50, 200)
STEPS = (1_250, 2_500, 5_000, 10_000)
MODEL_CENTRES, POLICY_CENTRES = 200, 80
TASKS = {"pendulum": (2, 1), "hopper": (11, 3), "cheetah": (17, 6)}  # sizes of an observation and an action


def spaces_of(d: int, n: int) -> Spaces:
    """Return the spaces of a task, with actions between -1 and 1."""
    return Spaces((d,), np.full(n, -1.0), np.full(n, 1.0))


def episodes_of(d: int, n: int, steps: int) -> Episodes:
    """Return episodes of a nonlinear system with d numbers in an observation and n in an action."""
    rng = np.random.default_rng(0)
    rows = -(-steps // HORIZON)
    by_state, by_action = rng.normal(size=(d, d)) / np.sqrt(d), rng.normal(size=(n, d))
    observations = np.empty((rows, HORIZON + 1, d))
    observations[:, 0] = rng.normal(size=(rows, d))
    actions = rng.uniform(-1.0, 1.0, (rows, HORIZON, n))
    for t in range(HORIZON):
        now = observations[:, t]
        change = np.tanh(2.0 * now @ by_state + actions[:, t] @ by_action) - 0.2 * now
        observations[:, t + 1] = now + 0.1 * change + 0.01 * rng.normal(size=now.shape)
    rewards = np.exp(-np.mean(observations[:, :-1] ** 2, axis=2)) - 0.1 * np.mean(actions**2, axis=2)
    mask = np.ones((rows, HORIZON), dtype=bool)
    return Episodes(observations[:, :-1], actions, rewards, mask, observations[:, -1], np.zeros(rows, dtype=bool))


def policy_of(d: int, n: int) -> GaussianPolicy:
    """Return a policy with the greatest number of centres."""
    rng = np.random.default_rng(1)
    mean = Function(
        RBF((np.sqrt(d),)), rng.normal(size=(POLICY_CENTRES, d)), 0.1 * rng.normal(size=(POLICY_CENTRES, n))
    )
    return GaussianPolicy(mean, ConstantVariance(np.full(n, 0.1)))


def fits(name: str, sizes: Sequence[int], repeats: int) -> None:
    """Print the time of a fit at growing numbers of steps."""
    d, n = TASKS[name]
    seconds = {}
    for steps in sizes:
        episodes = episodes_of(d, n, steps)
        seconds[steps] = seconds_of(
            partial(DynamicsModel.fit, episodes, Inputs(), spaces_of(d, n), MODEL_CENTRES), repeats
        )
        aim = "   (aim 2 s)" if steps == 5_000 else ""
        print(f"fit, {name:<9} {d:>2} + {n} numbers, {steps:>6} steps   {seconds[steps]:6.2f} s{aim}", flush=True)
    print(f"fit, {name:<9} growth {growth(seconds, sizes[0], sizes[-1]):.2f}   (aim at most 1)", flush=True)


def rollouts(name: str, steps: int, repeats: int) -> None:
    """Print the steps per second of model rollouts, with a model fitted to a number of steps."""
    d, n = TASKS[name]
    model = DynamicsModel.fit(episodes_of(d, n, steps), Inputs(), spaces_of(d, n), MODEL_CENTRES)
    runner, policy = ModelRunner(model), policy_of(d, n)
    for num_envs in NUM_ENVS:
        batch = Batch(2, 0, num_envs, HORIZON, explore=True)
        rate = num_envs * HORIZON / seconds_of(partial(runner.collect, policy, batch), repeats)
        aim = "   (aim 200000)" if name == "pendulum" else ""
        print(
            f"rollouts, {name:<9} {d:>2} + {n} numbers, {num_envs:>4} rollouts   {rate:9.0f} steps/s{aim}", flush=True
        )


def main() -> None:
    """Print the tables."""
    for name in TASKS:
        rollouts(name, steps=2_000, repeats=9)
    fits("cheetah", STEPS, repeats=3)


def main_quickly() -> None:
    """Print small tables."""
    rollouts("pendulum", steps=100, repeats=1)
    fits("pendulum", (100, 200), repeats=1)


if __name__ == "__main__":
    (main_quickly if parser(__doc__).parse_args().quick else main)()
