from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from rkhs_ros.learning.algorithms.critics import ValueBaseline, pursuit_critic, step_critic
from rkhs_ros.learning.samples import Samples
from rkhs_ros.rkhs.function import FixedBasis
from rkhs_ros.rkhs.kernels import LINEAR
from test.unit.conftest import random_episodes, random_policy

DISCOUNT = 0.9


@pytest.fixture
def samples(rng: np.random.Generator) -> Callable[..., Samples]:
    def make(n: int = 6, horizon: int = 8, centres: int = 5, *, masked: bool = False, learnt: bool = False) -> Samples:
        policy = random_policy(rng, learnt=learnt)
        return Samples.in_newton_basis(policy, random_episodes(rng, policy, n, horizon, masked=masked), centres)

    return make


@pytest.mark.parametrize("linear", [False, True], ids=["rbf", "linear"])
@pytest.mark.parametrize("trace", [1.0, 0.6])
def test_the_step_critic_is_least_squares_with_rows_for_the_penalties(
    samples: Callable[..., Samples], linear: bool, trace: float
) -> None:
    data = samples(6, 8, 5, masked=True, learnt=True)
    if linear:
        data = replace(data, basis=FixedBasis(LINEAR, np.eye(5)))
    scale = np.sqrt(np.mean(data.variance))
    scores = [scale * np.kron(f, e / v) for f, e, v in zip(data.features, data.exploration, data.variance, strict=True)]
    time = np.array([[1.0, t / 8, (t / 8) ** 2] for t in data.episodes.steps])

    def fit(rows: np.ndarray, targets: np.ndarray, ridges: list[float]) -> np.ndarray:
        squares = [
            1.0 if not linear or ridge == 1e-6 else np.mean(c**2) for c, ridge in zip(rows.T, ridges, strict=True)
        ]
        penalty = np.diag(np.sqrt(len(rows) * np.array(ridges) * squares))
        return np.linalg.lstsq(np.concatenate([rows, penalty]), np.append(targets, np.zeros(len(ridges))))[0]

    to_go = data.episodes.flat(data.episodes.rewards_to_go(DISCOUNT))
    of_state = np.column_stack([data.features, time])
    fitted = np.zeros(data.episodes.mask.shape)
    fitted[data.episodes.mask] = of_state @ fit(of_state, to_go, [0.3] * 5 + [1e-6] * 3)
    targets = data.episodes.flat(data.episodes.lambda_returns(fitted, DISCOUNT, trace))
    w = fit(np.column_stack([scores, of_state]), targets, [0.2] * 10 + [0.3] * 5 + [1e-6] * 3)[:10]
    got = step_critic(data, DISCOUNT, 0.2, ValueBaseline(0.3, trace))
    np.testing.assert_allclose(got.ravel(), scale * w, rtol=1e-7, atol=1e-9)


@pytest.mark.parametrize("trace", [1.0, 0.6])
def test_pursuit_of_steps_with_enough_atoms_is_ridge_regression_after_the_value(
    samples: Callable[..., Samples], trace: float
) -> None:
    data = samples(12, 8, 5, masked=True)  # of one action: w has as many coordinates as the pursuit may choose atoms
    data = replace(data, exploration=data.exploration[:, :1], variance=data.variance[:, :1])
    values = ValueBaseline(0.3).values(data, DISCOUNT)
    by_step = np.zeros(data.episodes.mask.shape)
    by_step[data.episodes.mask] = values
    targets = data.episodes.flat(data.episodes.lambda_returns(by_step, DISCOUNT, trace)) - values
    scale = np.sqrt(np.mean(data.variance))
    rows = scale * data.features * data.exploration / data.variance
    expected = scale * np.linalg.solve(rows.T @ rows + 0.2 * len(rows) * np.eye(5), rows.T @ targets)
    got = pursuit_critic(data, DISCOUNT, 0.2, ValueBaseline(0.3, trace))
    np.testing.assert_allclose(got[:, 0], expected, rtol=1e-8, atol=1e-10)
