import numpy as np
import pytest

from rkhs_ros.learning.samples import Samples
from rkhs_ros.policies.gaussian import GaussianPolicy
from rkhs_ros.rkhs.function import Function
from test.unit.conftest import inner, random_episodes, random_policy


@pytest.fixture
def policy(rng: np.random.Generator) -> GaussianPolicy:
    return random_policy(rng)


def test_score_features_are_coordinates_of_the_score(policy: GaussianPolicy, rng: np.random.Generator) -> None:
    # With as many centres as samples, <w, K(s, .) u> = w(s) . u for every w in their span.
    episodes = random_episodes(rng, policy, 3, 4, masked=True)
    samples = Samples.in_newton_basis(policy, episodes, centres=12)
    coefficients = rng.normal(size=(samples.features.shape[1], 2))
    w = samples.basis.function(coefficients)
    x, actions = samples.observations, episodes.flat(episodes.actions)
    score = (actions - policy.mean(x)) / policy.variance(x)
    expected = [
        inner(w, Function(policy.mean.kernel, s[None], u[None]))
        for s, u in zip(samples.observations, score, strict=True)
    ]
    np.testing.assert_allclose(samples.score_features @ coefficients.ravel(), expected, atol=1e-6)


def test_samples_contain_the_inputs_and_exploration_of_the_policy(
    policy: GaussianPolicy, rng: np.random.Generator
) -> None:
    episodes = random_episodes(rng, policy, 4, 5, masked=True)
    samples = Samples.in_newton_basis(policy, episodes, centres=3)
    assert len(samples.observations) == episodes.mask.sum()
    acted = policy.mean(samples.observations) + samples.exploration
    np.testing.assert_allclose(acted, episodes.flat(episodes.actions), rtol=1e-12)
    assert samples.features.shape == (len(samples.observations), 3)
    assert {tuple(c) for c in samples.basis.centres} <= {tuple(o) for o in samples.observations}


def test_the_time_features_span_the_quadratic_polynomials(policy: GaussianPolicy, rng: np.random.Generator) -> None:
    features = Samples.in_newton_basis(policy, random_episodes(rng, policy, 2, 6), centres=3).time_features
    t = np.tile(np.arange(6.0), 2)
    for target in (np.ones(12), t, t**2):
        np.testing.assert_allclose(features @ np.linalg.lstsq(features, target)[0], target, atol=1e-9)
    assert np.linalg.matrix_rank(features) == 3


def test_samples_on_given_centres_use_their_kernel_functions(policy: GaussianPolicy, rng: np.random.Generator) -> None:
    episodes, centres = random_episodes(rng, policy, 3, 4, masked=True), rng.normal(size=(5, 2))
    samples, other = Samples.on_centres(policy, episodes, centres), Samples.in_newton_basis(policy, episodes, 5)
    for row, s in zip(samples.features, episodes.flat(episodes.observations), strict=True):
        np.testing.assert_allclose(row, np.exp(-0.5 * np.sum((centres - s) ** 2, axis=1)), rtol=1e-12)
    for name in ("observations", "exploration", "variance", "score", "time_features"):
        assert np.array_equal(getattr(samples, name), getattr(other, name))
    w = rng.normal(size=(5, 2))
    np.testing.assert_allclose(samples.basis.function(w)(samples.observations), samples.features @ w, rtol=1e-12)
