from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from rkhs_ros.learning.critics import step_critic, trajectory_critic, value
from rkhs_ros.learning.episodes import Episodes
from rkhs_ros.learning.features import Samples
from rkhs_ros.policies.gaussian import GaussianPolicy

DISCOUNT = 0.9


@pytest.fixture
def samples(
    random_policy: Callable[..., GaussianPolicy], random_episodes: Callable[..., Episodes]
) -> Callable[..., Samples]:
    def make(n: int = 6, horizon: int = 8, centres: int = 5, *, masked: bool = False, learnt: bool = False) -> Samples:
        policy = random_policy(learnt=learnt)
        return Samples.of(policy, random_episodes(policy, n, horizon, masked=masked), centres)

    return make


def with_rewards_to_go(samples: Samples, wanted: np.ndarray) -> Samples:
    """Choose the rewards such that the rewards to go are the wanted ones at every sample."""
    to_go = np.zeros(samples.episodes.rewards.shape)
    to_go[samples.episodes.mask] = wanted
    following = np.concatenate([to_go[:, 1:], np.zeros((len(to_go), 1))], axis=1)
    return replace(samples, episodes=replace(samples.episodes, rewards=to_go - DISCOUNT * following))


@pytest.mark.parametrize("learnt", [False, True], ids=["constant variance", "learnt variance"])
@pytest.mark.parametrize("masked", [False, True], ids=["whole", "masked"])
def test_the_step_critic_recovers_a_w_that_explains_the_rewards(
    samples: Callable[..., Samples], rng: np.random.Generator, masked: bool, learnt: bool
) -> None:
    seen = samples(30, 10, masked=masked, learnt=learnt)
    w, v = rng.normal(size=(5, 2)), rng.normal(size=5)
    time = np.array([3.0, -2.0, 1.0])
    wanted = seen.score_features @ w.ravel() + seen.features @ v + seen.time_features @ time
    recovered = step_critic(with_rewards_to_go(seen, wanted), DISCOUNT, ridge=1e-12)
    np.testing.assert_allclose(recovered, w, rtol=1e-3, atol=1e-3)  # the trend's ridge leaves 1e-6


def test_the_step_critics_ridge_means_the_same_at_any_variance(samples: Callable[..., Samples]) -> None:
    seen = samples(20, 10)
    # Exploration and deviation ten times as large: u shrinks to a tenth, so w grows tenfold.
    wide = replace(seen, exploration=10 * seen.exploration, variance=100 * seen.variance)
    narrow, broad = (step_critic(s, DISCOUNT, ridge=0.1) for s in (seen, wide))
    np.testing.assert_allclose(broad, 10 * narrow, rtol=1e-8)


@pytest.mark.parametrize("masked", [False, True], ids=["whole", "masked"])
def test_the_value_recovers_what_states_and_time_explain(
    samples: Callable[..., Samples], rng: np.random.Generator, masked: bool
) -> None:
    seen = samples(30, 10, masked=masked)
    wanted = seen.features @ rng.normal(size=5) + seen.time_features @ np.array([3.0, -2.0, 1.0])
    np.testing.assert_allclose(value(with_rewards_to_go(seen, wanted), DISCOUNT, 1e-12), wanted, atol=1e-3)


@pytest.mark.parametrize(("n", "centres"), [(6, 12), (40, 3)], ids=["fewer episodes", "more episodes"])
@pytest.mark.parametrize("masked", [False, True], ids=["whole", "masked"])
def test_the_trajectory_critics_dual_is_its_primal(
    samples: Callable[..., Samples], n: int, centres: int, masked: bool
) -> None:
    seen = samples(n, 8, centres, masked=masked)
    returns = seen.episodes.returns(DISCOUNT)
    features, row = np.zeros((n, seen.score_features.shape[1])), 0
    for i, length in enumerate(seen.episodes.mask.sum(axis=1)):
        for t in range(length):
            features[i] += DISCOUNT**t * np.kron(seen.features[row], seen.exploration[row] / seen.variance[row])
            row += 1
    ridge = 0.3 * np.mean(np.sum(features**2, axis=1))
    # min |returns - features w - b|^2 + ridge |w|^2, the intercept b without a penalty
    p = features.shape[1]
    design = np.block([[features, np.ones((n, 1))], [np.sqrt(ridge) * np.eye(p), np.zeros((p, 1))]])
    primal = np.linalg.lstsq(design, np.append(returns, np.zeros(p)))[0][:p]
    np.testing.assert_allclose(trajectory_critic(seen, DISCOUNT, 0.3).ravel(), primal, rtol=1e-6, atol=1e-10)


@pytest.mark.parametrize("critic", [step_critic, trajectory_critic])
def test_a_constant_in_the_returns_changes_no_critic(
    samples: Callable[..., Samples], critic: Callable[..., np.ndarray]
) -> None:
    seen = samples(10, 8)
    rewards = seen.episodes.rewards.copy()
    rewards[:, -1] += 5.0 / DISCOUNT ** np.arange(8)[-1]
    shifted = replace(seen, episodes=replace(seen.episodes, rewards=rewards))
    if critic is step_critic:  # here the constant is one of every reward to go
        to_go = seen.episodes.rewards_to_go(DISCOUNT)
        shifted = with_rewards_to_go(seen, seen.episodes.flat(to_go + 5.0))
    np.testing.assert_allclose(critic(shifted, DISCOUNT, 0.1), critic(seen, DISCOUNT, 0.1), atol=1e-4)
