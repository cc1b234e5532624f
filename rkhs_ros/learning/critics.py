r"""Critics: estimates of the natural gradient w and of the value V from episodes.

Each fits :math:`w` and a baseline jointly by ridge regression in the coordinates of the Newton basis, where the
squared norm of a function in the RKHS is the squared norm of its coefficients.
"""

from __future__ import annotations

import numpy as np

from rkhs_ros.learning.features import Samples, ridge_regression
from rkhs_ros.rkhs.kernels import Array

TREND_RIDGE = 1e-6  # the trend over time is all but free


def value(samples: Samples, discount: float, ridge: float) -> Array:
    r"""Return :math:`V(s_t)` at each sample, shape (samples,).

    Fits the reward to go by a function of the state plus the span of 1, t, t^2.

    Args:
        samples: samples of the iteration.
        discount: discount factor.
        ridge: penalty on the squared norm of the value in the RKHS.
    """
    reward_to_go = samples.episodes.flat(samples.episodes.rewards_to_go(discount))
    features = np.concatenate([samples.features, samples.time_features], axis=1)
    penalty = _penalty(ridge, samples.features.shape[1], samples.time_features.shape[1])
    return np.asarray(features @ ridge_regression(features, reward_to_go[:, None], penalty)[:, 0])


def step_critic(samples: Samples, discount: float, ridge: float) -> Array:
    r"""Return the coefficients of w, shape (m, n), from an equation for each step (after Eq 12).

    .. math:: \sum_{k \ge t} \gamma^{k-t} r_k = \langle w, K(s_t, \cdot) u_t \rangle + V(s_t) + (1, t, t^2)\,\beta

    Far less variance than the episode's equation. The regressors :math:`u_t` are scaled by the root mean square
    exploration, so that the ridge means the same at any variance.

    Args:
        samples: samples of the iteration.
        discount: discount factor.
        ridge: penalty on the squared norms of w, in those units, and V.
    """
    reward_to_go = samples.episodes.flat(samples.episodes.rewards_to_go(discount))
    scale = np.sqrt(samples.variance.mean())
    score_features = scale * samples.score_features
    features = np.concatenate([score_features, samples.features, samples.time_features], axis=1)
    penalised = score_features.shape[1] + samples.features.shape[1]
    penalty = _penalty(ridge, penalised, samples.time_features.shape[1])
    coefficients = ridge_regression(features, reward_to_go[:, None], penalty)[: score_features.shape[1]]
    return np.asarray(scale * coefficients.reshape(-1, samples.exploration.shape[1]))


def trajectory_critic(samples: Samples, discount: float, ridge: float) -> Array:
    r"""Return the coefficients of w, shape (m, n), from an equation for each episode (section 3.2, "the critic").

    .. math:: \sum_t \gamma^t r_t = \langle w, \sum_t \gamma^t K(s_t, \cdot) u_t \rangle + V(s_0)

    solved in its dual over the N x N trajectory Gram :math:`\Lambda` with
    :math:`M = (\Lambda + \lambda I)^{-1}` and the intercept :math:`b = 1^\top M R / 1^\top M 1` for
    :math:`V(s_0)`.

    Args:
        samples: samples of the iteration.
        discount: discount factor.
        ridge: lambda relative to the mean diagonal of the Gram.
    """
    episodes = samples.episodes
    discounts = discount**episodes.steps
    per_step = np.zeros((*episodes.mask.shape, samples.score_features.shape[1]))
    per_step[episodes.mask] = discounts[:, None] * samples.score_features
    features = per_step.sum(axis=1)
    gram = features @ features.T
    ones, returns = np.ones(len(gram)), episodes.returns(discount)
    regular = gram + ridge * max(np.trace(gram) / len(gram), np.finfo(float).tiny) * np.eye(len(gram))
    inverse_ones, inverse_returns = np.linalg.solve(regular, np.stack([ones, returns], axis=1)).T
    intercept = (ones @ inverse_returns) / (ones @ inverse_ones)
    coefficients = features.T @ (inverse_returns - intercept * inverse_ones)
    return np.asarray(coefficients.reshape(-1, samples.exploration.shape[1]))


def _penalty(ridge: float, penalised: int, free: int) -> Array:
    return np.concatenate([np.full(penalised, ridge), np.full(free, TREND_RIDGE)])


CRITICS = {"step": step_critic, "trajectory": trajectory_critic}
