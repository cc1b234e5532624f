r"""Critics: estimates of the natural gradient w and of the value V from episodes.

Each fits :math:`w` and a baseline in the samples' coordinates: in a Newton basis the squared norm of a function in
the RKHS is the squared norm of its coefficients, on fixed centres it is that of the weights.
"""

from __future__ import annotations

import numpy as np

from rkhs_ros.learning.features import Samples, ridge_regression
from rkhs_ros.rkhs.kernels import Array
from rkhs_ros.rkhs.pursuit import pursue_atoms

NOTHING = 1e-200  # below it all features vanish, as far from every centre
TREND_RIDGE = 1e-6  # the trend over time is all but free
PENALTIES = ("norm", "scale_free")


def value(samples: Samples, discount: float, ridge: float, ridge_norm: str = "norm") -> Array:
    r"""Return :math:`V(s_t)` at each sample, shape (samples,).

    Fits the reward to go by a function of the state plus the span of 1, t, t^2.

    Args:
        samples: samples of the iteration.
        discount: discount factor.
        ridge: penalty on the squared norm of the value.
        ridge_norm: one of `PENALTIES`.
    """
    reward_to_go = samples.episodes.flat(samples.episodes.rewards_to_go(discount))
    features = np.concatenate([samples.features, samples.time_features], axis=1)
    penalty = _penalty(samples.features, samples.time_features, ridge, ridge_norm)
    return np.asarray(features @ ridge_regression(features, reward_to_go[:, None], penalty)[:, 0])


def returns_to_go(samples: Samples, discount: float, value_ridge: float, ridge_norm: str, trace: float) -> Array:
    """Return the lambda returns of the fitted value at each sample, shape (samples,); rewards to go at a trace of 1.

    They hold less of the noise of steps far ahead, at the price of the value's error.
    """
    episodes = samples.episodes
    values = np.zeros(episodes.mask.shape)
    if trace < 1.0:
        values[episodes.mask] = value(samples, discount, value_ridge, ridge_norm)
    return episodes.flat(episodes.lambda_returns(values, discount, trace))


def step_critic(
    samples: Samples,
    discount: float,
    ridge: float,
    ridge_norm: str = "norm",
    *,
    value_ridge: float | None = None,
    trace: float = 1.0,
) -> Array:
    r"""Return the coefficients of w, shape (m, n), from an equation for each step (after Eq 12).

    .. math:: \sum_{k \ge t} \gamma^{k-t} r_k = \langle w, K(s_t, \cdot) u_t \rangle + V(s_t) + (1, t, t^2)\,\beta

    Far less variance than the episode's equation. The regressors :math:`u_t` are scaled by the root mean square
    exploration, so that the ridge means the same at any variance.

    Args:
        samples: samples of the iteration.
        discount: discount factor.
        ridge: penalty on the squared norm of w, in those units.
        ridge_norm: one of `PENALTIES`.
        value_ridge: penalty on the squared norm of V; the ridge where None.
        trace: lambda of the returns on the left.
    """
    value_ridge = ridge if value_ridge is None else value_ridge
    returns = returns_to_go(samples, discount, value_ridge, ridge_norm, trace)
    scale = np.sqrt(samples.variance.mean())
    score_features = scale * samples.score_features
    features = np.concatenate([score_features, samples.features, samples.time_features], axis=1)
    value_penalty = _penalty(samples.features, samples.time_features, value_ridge, ridge_norm)
    penalty = np.concatenate([ridge * _squares(score_features, ridge_norm), value_penalty])
    coefficients = ridge_regression(features, returns[:, None], penalty)[: score_features.shape[1]]
    return np.asarray(scale * coefficients.reshape(-1, samples.exploration.shape[1]))


def trajectory_critic(samples: Samples, discount: float, ridge: float, ridge_norm: str = "norm") -> Array:
    r"""Return the coefficients of w, shape (m, n), from an equation for each episode (section 3.2, "the critic").

    .. math:: \sum_t \gamma^t r_t = \langle w, \sum_t \gamma^t K(s_t, \cdot) u_t \rangle + V(s_0)

    with one intercept for :math:`V(s_0)`, by `dual_regression`.

    Args:
        samples: samples of the iteration.
        discount: discount factor.
        ridge: lambda relative to the mean diagonal of the Gram.
        ridge_norm: one of `PENALTIES`.
    """
    features = trajectory_features(samples, discount)
    units = np.sqrt(_squares(features, ridge_norm))
    scaled = features / units
    dual = dual_regression(scaled, samples.episodes.returns(discount), ridge)
    return np.asarray((scaled.T @ dual / units).reshape(-1, samples.exploration.shape[1]))


def pursuit_critic(
    samples: Samples,
    discount: float,
    ridge: float,
    ridge_norm: str = "norm",
    *,
    equations: str = "step",
    value_ridge: float | None = None,
    trace: float = 1.0,
) -> Array:
    r"""Return the coefficients of w, shape (m, n), by kernel matching pursuit in the compatible kernel (Eq 11).

    :math:`w = \sum_j \beta_j K(s_j, \cdot)\, u_j` over at most m samples j, which fit what is left of the steps' or
    the episodes' returns without their value.

    Args:
        samples: samples of the iteration.
        discount: discount factor.
        ridge: penalty on the squared norm of w.
        ridge_norm: one of `PENALTIES`, of the value.
        equations: ``step`` or ``trajectory``.
        value_ridge: penalty on the squared norm of V; the ridge where None.
        trace: lambda of the steps' returns.
    """
    scale = np.sqrt(samples.variance.mean())
    atoms = scale * samples.score_features
    if equations == "step":
        rows = atoms
        targets = advantages(samples, discount, ridge if value_ridge is None else value_ridge, ridge_norm, trace)
    else:
        rows, returns = scale * trajectory_features(samples, discount), samples.episodes.returns(discount)
        targets = returns - returns.mean()
    budget = samples.features.shape[1]
    chosen, weights = pursue_atoms(rows, targets[:, None], atoms, budget=budget, ridge=ridge)
    return np.asarray(scale * (weights[:, 0] @ atoms[chosen]).reshape(-1, samples.exploration.shape[1]))


def advantages(samples: Samples, discount: float, ridge: float, ridge_norm: str = "norm", trace: float = 1.0) -> Array:
    """Return the returns to go less the value at each sample, shape (samples,)."""
    returns = returns_to_go(samples, discount, ridge, ridge_norm, trace)
    return np.asarray(returns - value(samples, discount, ridge, ridge_norm))


def trajectory_features(samples: Samples, discount: float) -> Array:
    r"""Return :math:`\sum_t \gamma^t K(s_t, \cdot) u_t` of each episode in coordinates, shape (N, m n)."""
    discounted = discount ** samples.episodes.steps[:, None] * samples.score_features
    return np.asarray(np.add.reduceat(discounted, samples.episodes.begins, axis=0))


def dual_regression(features: Array, returns: Array, ridge: float, *, intercept: bool = True) -> Array:
    r"""Return :math:`M (R - b 1)`, shape (N,), through the trajectory Gram (after Eq 18).

    .. math:: M = (\Lambda + \lambda I)^{-1}, \qquad b = 1^\top M R / 1^\top M 1

    Args:
        features: of the episodes, shape (N, p); :math:`\Lambda` holds their inner products.
        returns: R, shape (N,).
        ridge: lambda relative to the mean diagonal of the Gram.
        intercept: whether there is one; else b = 0.
    """
    gram = features @ features.T
    scale = np.trace(gram) / len(gram)
    regular = gram + ridge * (scale if scale > NOTHING else 1.0) * np.eye(len(gram))
    ones = np.ones(len(gram))
    inverse_ones, inverse_returns = np.linalg.solve(regular, np.stack([ones, returns], axis=1)).T
    b = (ones @ inverse_returns) / (ones @ inverse_ones) if intercept else 0.0
    return np.asarray(inverse_returns - b * inverse_ones)


def _penalty(functions: Array, trend: Array, ridge: float, ridge_norm: str) -> Array:
    return np.concatenate([ridge * _squares(functions, ridge_norm), np.full(trend.shape[1], TREND_RIDGE)])


def _squares(columns: Array, ridge_norm: str) -> Array:
    """Return the mean square of each column where the ridge is to be free of their scale, else 1."""
    if ridge_norm == "norm":
        return np.ones(columns.shape[1])
    squares = np.mean(columns**2, axis=0)
    return np.where(squares > 0, squares, 1.0)


CRITICS = {"step": step_critic, "trajectory": trajectory_critic}
