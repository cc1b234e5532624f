from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from rkhs_ros.learning.critics import pursuit_critic, step_critic, trajectory_critic, value
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


@pytest.mark.parametrize("masked", [False, True], ids=["whole", "masked"])
@pytest.mark.parametrize("norm", ["norm", "scale_free"])
@pytest.mark.parametrize("trace", [1.0, 0.6, 0.0])
def test_the_step_critic_is_least_squares_on_rows_for_its_penalties(
    samples: Callable[..., Samples], masked: bool, norm: str, trace: float
) -> None:
    seen = samples(6, 8, 5, masked=masked, learnt=True)
    scale = np.sqrt(np.mean(seen.variance))
    scores = [scale * np.kron(f, e / v) for f, e, v in zip(seen.features, seen.exploration, seen.variance, strict=True)]
    time = np.array([[1.0, t / 8, (t / 8) ** 2] for t in seen.episodes.steps])

    def fit(rows: np.ndarray, targets: np.ndarray, ridges: list[float]) -> np.ndarray:
        squares = [
            1.0 if norm == "norm" or ridge == 1e-6 else np.mean(c**2) for c, ridge in zip(rows.T, ridges, strict=True)
        ]
        penalty = np.diag(np.sqrt(len(rows) * np.array(ridges) * squares))
        return np.linalg.lstsq(np.concatenate([rows, penalty]), np.append(targets, np.zeros(len(ridges))))[0]

    to_go = seen.episodes.flat(seen.episodes.rewards_to_go(DISCOUNT))
    of_state = np.column_stack([seen.features, time])
    fitted = np.zeros(seen.episodes.mask.shape)
    fitted[seen.episodes.mask] = of_state @ fit(of_state, to_go, [0.3] * 5 + [1e-6] * 3)
    targets = seen.episodes.flat(seen.episodes.lambda_returns(fitted, DISCOUNT, trace))
    w = fit(np.column_stack([scores, of_state]), targets, [0.2] * 10 + [0.3] * 5 + [1e-6] * 3)[:10]
    got = step_critic(seen, DISCOUNT, 0.2, norm, value_ridge=0.3, trace=trace)
    np.testing.assert_allclose(got.ravel(), scale * w, rtol=1e-7, atol=1e-9)


@pytest.mark.parametrize("equations", ["step", "trajectory"])
def test_a_pursuit_over_enough_atoms_is_the_ridge_regression_after_the_value(
    samples: Callable[..., Samples], equations: str
) -> None:
    seen = samples(12, 8, 5)
    seen = replace(seen, exploration=seen.exploration[:, :1], variance=seen.variance[:, :1])  # five coordinates of w
    scale = np.sqrt(np.mean(seen.variance))
    rows = scale * seen.features * seen.exploration / seen.variance
    if equations == "step":
        targets = seen.episodes.flat(seen.episodes.rewards_to_go(DISCOUNT)) - value(seen, DISCOUNT, 0.3)
    else:
        rows = np.array([DISCOUNT ** np.arange(8) @ rows[8 * i : 8 * i + 8] for i in range(12)])
        returns = seen.episodes.returns(DISCOUNT)
        targets = returns - returns.mean()
    expected = np.linalg.solve(rows.T @ rows + 0.2 * len(rows) * np.eye(5), rows.T @ targets)
    got = pursuit_critic(seen, DISCOUNT, 0.2, equations=equations, value_ridge=0.3)
    np.testing.assert_allclose(got[:, 0], scale * expected, rtol=1e-8, atol=1e-10)
