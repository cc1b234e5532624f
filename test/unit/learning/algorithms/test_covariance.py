"""The natural gradient does not depend on the coordinates of the function space."""

import numpy as np
import pytest

from rkhs_ros.learning.algorithms.actor_critic import ActorCritic
from rkhs_ros.learning.algorithms.rkhs_nac import RKHSNAC
from rkhs_ros.learning.algorithms.step_rules import FixedStep, KLStep
from rkhs_ros.learning.episodes import Episodes
from rkhs_ros.learning.samples import Samples
from rkhs_ros.policies.gaussian import GaussianPolicy
from rkhs_ros.policies.inputs import Inputs
from rkhs_ros.policies.variance import ConstantVariance
from rkhs_ros.rkhs.function import Function
from rkhs_ros.rkhs.kernels import LINEAR
from test.unit.conftest import learn, random_episodes, random_policy

OFFSETS = (0.01, 0.2, 1.0)
DEGREE = 5
TEST_POINTS = np.linspace(-1.0, 1.0, 21)[:, None]  # further out the highest power dominates
over_critics = pytest.mark.parametrize("critic", ["step", "trajectory"])


def estimate(critic: str, ridge: float, samples: Samples) -> np.ndarray:
    """Return the estimate of a critic with the same ridge for w and the value."""
    algorithm = RKHSNAC(critic=critic, ridge=ridge, value_ridge=ridge, trace=1.0)
    return algorithm.natural_gradient(samples, 0.9)


def walks(n: int = 12, horizon: int = 15) -> Episodes:
    """Return random walks along a line with a reward at its end."""
    rng = np.random.default_rng(3)
    actions = rng.normal(scale=0.7, size=(n, horizon, 1))
    places = np.clip(np.cumsum(np.concatenate([np.zeros((n, 1, 1)), actions[:, :-1]], axis=1), axis=1), -1.5, 3.5)
    rewards = np.exp(-np.abs(places[:, :, 0] - 3.0))
    return Episodes.without_ends(places, actions, rewards, np.ones((n, horizon), dtype=bool))


def moves(algorithm: ActorCritic, mean: np.ndarray) -> list[np.ndarray]:
    """Return how the mean changes at the test points in the coordinates of each offset.

    Args:
        algorithm: the algorithm.
        mean: coefficients of the powers 0 to 5 of the policy's mean, the same function in all coordinates.
    """
    changes = []
    for offset in OFFSETS:
        inputs = Inputs(degree=DEGREE, offset=offset)
        nodes = np.linspace(-1.5, 3.5, DEGREE + 1)[:, None]  # the values at these points determine a polynomial
        weights = np.linalg.solve(inputs.features(nodes), np.polynomial.polynomial.polyval(nodes, mean))
        function = Function(LINEAR, np.eye(DEGREE + 1), weights.reshape(-1, 1))
        policy = GaussianPolicy(function, ConstantVariance(np.array([0.5])), inputs)
        moved, *_ = learn(algorithm, policy, walks().with_inputs(inputs))
        points = inputs.features(TEST_POINTS)
        changes.append(moved.mean(points) - policy.mean(points))
    return changes


MEANS = [np.zeros(6), np.array([0.3, -0.2, 0.1, 0.05, -0.02, 0.003])]


@over_critics
@pytest.mark.parametrize("mean", MEANS, ids=["from 0", "from a polynomial"])
@pytest.mark.parametrize("ridge", [1e-6, 1.0])
def test_the_natural_gradient_does_not_change_with_the_parametrisation(
    critic: str, mean: np.ndarray, ridge: float
) -> None:
    for step in (FixedStep(0.5), KLStep(0.02)):
        algorithm = RKHSNAC(centres=20, critic=critic, ridge=ridge, step=step)
        first, *others = moves(algorithm, mean)
        assert np.linalg.norm(first) > 1e-3
        for other in others:
            np.testing.assert_allclose(other, first, rtol=0, atol=1e-6 * np.abs(first).max())


@over_critics
def test_scaling_the_coordinates_does_not_change_the_critic_of_a_linear_kernel(
    rng: np.random.Generator, critic: str
) -> None:
    policy = random_policy(rng, d=6, kernel=LINEAR)
    samples = RKHSNAC(centres=6).samples(policy, random_episodes(rng, policy, 8, 10, masked=True))
    units = 10 ** rng.uniform(-3, 3, samples.features.shape[1])
    scaled = Samples(**{**vars(samples), "features": samples.features * units})
    w, v = (estimate(critic, 0.1, s) for s in (samples, scaled))
    np.testing.assert_allclose(scaled.features @ v, samples.features @ w, rtol=1e-6, atol=1e-9)
