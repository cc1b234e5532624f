"""The units of a task do not affect learning; results are bit-identical for powers of 2."""

from collections.abc import Iterator
from functools import cache
from typing import Any, NamedTuple

import gymnasium
import numpy as np
import pytest
from gymnasium.spaces import Box

from rkhs_ros.base.settings import build
from rkhs_ros.learning.iteration import Iteration
from rkhs_ros.learning.training import train
from rkhs_ros.learning.training_settings import Training
from rkhs_ros.rollouts.inline_runner import InlineRunner
from rkhs_ros.rollouts.simulation import Simulation
from rkhs_ros.runs.defaults import settings_for

MILLIARD = 2.0**30  # a power of 2, which does not change the digits of a product
LIMIT = 2.0  # radians from the bottom at which an episode ends
OVER = 5.0  # reward of the last step


class Units(NamedTuple):
    """Factors on the observations, actions and rewards of a task."""

    observations: tuple[float, float] = (1.0, 1.0)
    actions: float = 1.0
    rewards: float = 1.0


class Pushed(gymnasium.Env[Any, Any]):
    """A hanging pendulum with two actuators, in any units; the episode ends far from the bottom."""

    def __init__(self, units: Units) -> None:
        self._units = units
        self.observation_space = Box(-np.inf, np.inf, (2,), np.float64)
        high = np.array([2.0, 3.0]) * units.actions
        self.action_space = Box(-high, high, dtype=np.float64)

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        super().reset(seed=seed)
        self._state = self.np_random.uniform(-0.5, 0.5, 2)
        return self._state * self._units.observations, {}

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        angle, velocity = self._state
        one, two = action / self._units.actions
        velocity += 0.3 * (one + 0.5 * two - np.sin(angle)) + 0.02 * self.np_random.standard_normal()
        self._state = np.array([angle + 0.3 * velocity, velocity])
        over = bool(abs(self._state[0]) > LIMIT)
        reward = 1.0 - np.cos(angle) - 0.01 * two**2 + OVER * over
        return self._state * self._units.observations, float(reward * self._units.rewards), over, False, {}


def settings(algorithm: str, form: str) -> Training:
    """Return the settings of a very short run."""
    model = {"form": form, **({"updates": 3, "rollouts": 6, "centres": 30} if form != "none" else {})}
    small = {"iterations": 3, "episodes_per_iteration": 3, "evaluation_episodes": 2, "horizon": 15}
    tree = {**settings_for(algorithm, form), **small, "model": model}
    return build(Training, {**tree, "algorithm": {**tree["algorithm"], "centres": 20}})


def learn(training: Training, units: Units) -> Iterator[Iteration]:
    return train(training, InlineRunner(Simulation(lambda: Pushed(units))))


@cache
def plain(training: Training) -> list[Iteration]:
    return list(learn(training, Units()))


def assert_same(training: Training, units: Units) -> None:
    """Train in other units and compare all results in the original ones."""
    sizes = np.array(units.observations)
    for ours, theirs in zip(plain(training), learn(training, units), strict=True):
        for name, unit in (
            ("exploration_returns", units.rewards),
            ("evaluation_returns", units.rewards),
            ("model_return", units.rewards),
            ("model_error", 1.0),
        ):
            np.testing.assert_array_equal(np.asarray(getattr(theirs, name)) / unit, getattr(ours, name))
        for name in ("kl", "centres", "sparsification_error"):
            np.testing.assert_array_equal(getattr(theirs.metrics, name), getattr(ours.metrics, name))
        np.testing.assert_array_equal(theirs.policy.mean.centres / sizes, ours.policy.mean.centres)
        np.testing.assert_array_equal(theirs.policy.mean.weights / units.actions, ours.policy.mean.weights)
        points = ours.exploration.flat(ours.exploration.observations)
        spread = theirs.policy.variance(points * sizes) / units.actions**2
        np.testing.assert_array_equal(spread, ours.policy.variance(points))


OTHER = [
    Units((1 / MILLIARD, MILLIARD), MILLIARD, 1 / MILLIARD),
    Units((MILLIARD, 1 / MILLIARD), 1 / MILLIARD, MILLIARD),
]
over_models = pytest.mark.parametrize("form", ["none", "gaussian_process"])
over_algorithms = pytest.mark.parametrize("algorithm", ["rkhs_nac", "rkhs_npg", "rkhs_ac", "rkhs_power"])


@pytest.mark.parametrize("units", OTHER, ids=["one way", "the other way"])
@over_models
@over_algorithms
def test_results_are_bit_identical_in_units_of_powers_of_two(algorithm: str, form: str, units: Units) -> None:
    assert_same(settings(algorithm, form), units)


def test_the_compared_runs_learn_and_contain_ended_episodes() -> None:
    *_, last = learn(settings("rkhs_nac", "none"), Units())
    assert last.policy.mean.weights.any()
    assert last.metrics.kl > 0.01
    assert last.exploration.terminated.any()
