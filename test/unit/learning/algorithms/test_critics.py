from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from rkhs_ros.learning.algorithms.critics import (
    Critic,
    StepCritic,
    StepPursuitCritic,
    TrajectoryCritic,
    TrajectoryPursuitCritic,
    ValueBaseline,
)
from rkhs_ros.learning.episodes import Episodes
from rkhs_ros.learning.samples import Samples
from rkhs_ros.policies.gaussian import GaussianPolicy

DISCOUNT = 0.9


@pytest.fixture
def samples(
    random_policy: Callable[..., GaussianPolicy], random_episodes: Callable[..., Episodes]
) -> Callable[..., Samples]:
    def make(n: int = 6, horizon: int = 8, centres: int = 5, *, masked: bool = False, learnt: bool = False) -> Samples:
        policy = random_policy(learnt=learnt)
        return Samples.in_newton_basis(policy, random_episodes(policy, n, horizon, masked=masked), centres)

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
    critic = StepCritic(1e-12, ValueBaseline(1e-12))
    recovered = critic.fit(with_rewards_to_go(seen, wanted), DISCOUNT)
    np.testing.assert_allclose(recovered, w, rtol=1e-3, atol=1e-3)  # the trend's ridge leaves 1e-6


def test_the_step_critics_ridge_means_the_same_at_any_variance(samples: Callable[..., Samples]) -> None:
    seen = samples(20, 10)
    # Exploration and deviation ten times as large: u shrinks to a tenth, so w grows tenfold.
    wide = replace(seen, exploration=10 * seen.exploration, variance=100 * seen.variance)
    critic = StepCritic(0.1, ValueBaseline(0.1))
    narrow, broad = (critic.fit(s, DISCOUNT) for s in (seen, wide))
    np.testing.assert_allclose(broad, 10 * narrow, rtol=1e-8)


@pytest.mark.parametrize("masked", [False, True], ids=["whole", "masked"])
def test_the_value_recovers_what_states_and_time_explain(
    samples: Callable[..., Samples], rng: np.random.Generator, masked: bool
) -> None:
    seen = samples(30, 10, masked=masked)
    wanted = seen.features @ rng.normal(size=5) + seen.time_features @ np.array([3.0, -2.0, 1.0])
    recovered = ValueBaseline(1e-12).values(with_rewards_to_go(seen, wanted), DISCOUNT)
    np.testing.assert_allclose(recovered, wanted, atol=1e-3)


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
    dual = TrajectoryCritic(0.3).fit(seen, DISCOUNT)
    np.testing.assert_allclose(dual.ravel(), primal, rtol=1e-6, atol=1e-10)


@pytest.mark.parametrize(
    "critic", [StepCritic(0.1, ValueBaseline(0.1)), TrajectoryCritic(0.1)], ids=["step", "trajectory"]
)
def test_a_constant_in_the_returns_changes_no_critic(samples: Callable[..., Samples], critic: Critic) -> None:
    seen = samples(10, 8)
    rewards = seen.episodes.rewards.copy()
    rewards[:, -1] += 5.0 / DISCOUNT ** np.arange(8)[-1]
    shifted = replace(seen, episodes=replace(seen.episodes, rewards=rewards))
    if isinstance(critic, StepCritic):  # here the constant is one of every reward to go
        to_go = seen.episodes.rewards_to_go(DISCOUNT)
        shifted = with_rewards_to_go(seen, seen.episodes.flat(to_go + 5.0))
    np.testing.assert_allclose(critic.fit(shifted, DISCOUNT), critic.fit(seen, DISCOUNT), atol=1e-4)


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
    got = StepCritic(0.2, ValueBaseline(0.3, norm, trace), norm).fit(seen, DISCOUNT)
    np.testing.assert_allclose(got.ravel(), scale * w, rtol=1e-7, atol=1e-9)


@pytest.mark.parametrize("trace", [1.0, 0.6])
def test_a_pursuit_of_steps_over_enough_atoms_is_the_ridge_regression_after_the_value(
    samples: Callable[..., Samples], trace: float
) -> None:
    seen = one_dimensional(samples(12, 8, 5, masked=True))
    values = ValueBaseline(0.3).values(seen, DISCOUNT)
    by_step = np.zeros(seen.episodes.mask.shape)
    by_step[seen.episodes.mask] = values
    targets = seen.episodes.flat(seen.episodes.lambda_returns(by_step, DISCOUNT, trace)) - values
    got = StepPursuitCritic(0.2, ValueBaseline(0.3, trace=trace)).fit(seen, DISCOUNT)
    assert_is_ridge_regression(got, seen, score_rows(seen), targets)


def test_a_pursuit_of_trajectories_over_enough_atoms_is_the_ridge_regression_after_the_mean(
    samples: Callable[..., Samples],
) -> None:
    seen = one_dimensional(samples(12, 8, 5))
    rows = np.array([DISCOUNT ** np.arange(8) @ score_rows(seen)[8 * i : 8 * i + 8] for i in range(12)])
    returns = seen.episodes.returns(DISCOUNT)
    got = TrajectoryPursuitCritic(0.2).fit(seen, DISCOUNT)
    assert_is_ridge_regression(got, seen, rows, returns - returns.mean())


def one_dimensional(samples: Samples) -> Samples:
    """Keep one action dimension, so that w has as many coordinates as the pursuit may choose atoms."""
    return replace(samples, exploration=samples.exploration[:, :1], variance=samples.variance[:, :1])


def score_rows(samples: Samples) -> np.ndarray:
    return np.sqrt(np.mean(samples.variance)) * samples.features * samples.exploration / samples.variance


def assert_is_ridge_regression(w: np.ndarray, samples: Samples, rows: np.ndarray, targets: np.ndarray) -> None:
    expected = np.linalg.solve(rows.T @ rows + 0.2 * len(rows) * np.eye(5), rows.T @ targets)
    scale = np.sqrt(np.mean(samples.variance))
    np.testing.assert_allclose(w[:, 0], scale * expected, rtol=1e-8, atol=1e-10)
