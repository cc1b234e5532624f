r"""Critics: estimates of the natural gradient w, by regression of returns on the gradient of the log policy.

The advantage is taken to be compatible with the policy, linear in the same features (Eq 12):

.. math:: A(s, a) = \langle w, K(s, \cdot)\, u \rangle, \qquad u = \Sigma^{-1} (a - h(s))

Then w is the natural gradient. A critic sets up one equation for it at each step or for each episode, and solves
them by ridge regression or by kernel matching pursuit: two times two critics. The coefficients that they return are
those of the samples' basis. In a Newton basis their squared norm is that of the function in the RKHS.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from rkhs_ros.learning.samples import Rows, Samples
from rkhs_ros.rkhs.kernels import Array
from rkhs_ros.rkhs.pursuit import pursue_atoms
from rkhs_ros.rkhs.regression import by_blocks, relative_ridge_regression, ridge_regression_by_blocks

TREND_RIDGE = 1e-6  # penalty on the coefficients of 1, t and t^2, all but none
RIDGE_NORMS = ("norm", "scale_free")


class Critic(Protocol):
    """An estimate of the natural gradient."""

    def fit(self, samples: Samples, discount: float) -> Array:
        """Return the coefficients of w, shape (m, n).

        Args:
            samples: samples of the iteration.
            discount: discount factor gamma of the return.
        """


def ridge_scales(columns: Array, ridge_norm: str) -> Array:
    """Return what a ridge multiplies each squared coefficient by, shape (p,).

    Args:
        columns: features, shape (samples, p).
        ridge_norm: ``norm``: 1, so that it penalises the norms of functions; ``scale_free``: the mean square of the
            column, so that the units of the coordinates do not matter.
    """
    if ridge_norm == "norm":
        return np.ones(columns.shape[1])
    squares = np.mean(columns**2, axis=0)
    return np.where(squares > 0, squares, 1.0)


@dataclass(frozen=True)
class ValueBaseline:
    r"""The value: a function of the state and a trend over time, fitted to the rewards to go.

    .. math:: \sum_{k \ge t} \gamma^{k-t} r_k = V(s_t) + (1, t, t^2)\, \beta

    Attributes:
        ridge: penalty on the squared norm of V.
        ridge_norm: one of `RIDGE_NORMS`.
        trace: lambda of the returns made with these values. Below 1 they hold less of the noise of steps far ahead,
            at the price of the values' error; at 1 they are the rewards to go.
    """

    ridge: float
    ridge_norm: str = "norm"
    trace: float = 1.0

    def values(self, samples: Samples, discount: float) -> Array:
        """Return the values, trend included, at each sample, shape (samples,)."""
        time_features, returns = samples.time_features, samples.rewards_to_go(discount)

        def columns(rows: slice) -> Array:
            return np.concatenate([samples.features[rows], time_features[rows]], axis=1)

        solution = ridge_regression_by_blocks(columns, returns[:, None], self.penalty(samples))
        return by_blocks(lambda rows: np.asarray(columns(rows) @ solution[:, 0]), len(returns))

    def returns(self, samples: Samples, discount: float) -> Array:
        """Return the lambda returns of each sample, shape (samples,)."""
        if self.trace == 1.0:  # no values enter
            return samples.rewards_to_go(discount)
        return samples.lambda_returns(self.values(samples, discount), discount, self.trace)

    def advantages(self, samples: Samples, discount: float) -> Array:
        """Return the lambda returns less the values at each sample, shape (samples,)."""
        values = self.values(samples, discount)
        if self.trace == 1.0:
            return np.asarray(samples.rewards_to_go(discount) - values)
        return np.asarray(samples.lambda_returns(values, discount, self.trace) - values)

    def penalty(self, samples: Samples) -> Array:
        """Return the penalties on the coefficients of V and then of the trend, shape (m + 3,)."""
        state = self.ridge * ridge_scales(samples.features, self.ridge_norm)
        return np.concatenate([state, np.full(samples.time_features.shape[1], TREND_RIDGE)])


@dataclass(frozen=True)
class StepCritic:
    r"""One equation at each step, by ridge regression for w, V and the trend together (after Eq 12).

    .. math:: \sum_{k \ge t} \gamma^{k-t} r_k = \langle w, K(s_t, \cdot)\, u_t \rangle + V(s_t) + (1, t, t^2)\, \beta

    It has far less variance than the critic of an equation for each episode. The :math:`u_t` are multiplied by the
    policy's deviation, so that the ridge means the same at any variance.

    Attributes:
        ridge: penalty on the squared norm of w, in those units.
        baseline: V and the trend; its lambda returns are the left side.
        ridge_norm: one of `RIDGE_NORMS`.
    """

    ridge: float
    baseline: ValueBaseline
    ridge_norm: str = "norm"

    def fit(self, samples: Samples, discount: float) -> Array:
        """Return the coefficients of w, shape (m, n)."""
        deviation, time_features = samples.deviation, samples.time_features

        def columns(rows: slice) -> Array:
            scores = deviation * samples.score_features_of(rows)
            return np.concatenate([scores, samples.features[rows], time_features[rows]], axis=1)

        scales = self._scales(samples)
        penalty = np.concatenate([self.ridge * scales, self.baseline.penalty(samples)])
        returns = self.baseline.returns(samples, discount)
        solution = ridge_regression_by_blocks(columns, returns[:, None], penalty)
        return deviation * samples.as_coefficients(solution[: len(scales)])

    def _scales(self, samples: Samples) -> Array:
        """Return what the ridge multiplies each squared coefficient of w by, shape (m n,)."""
        if self.ridge_norm == "norm":  # the scores of all samples at once need not be formed
            return np.ones(samples.features.shape[1] * samples.exploration.shape[1])
        return ridge_scales(samples.deviation * samples.score_features, self.ridge_norm)


@dataclass(frozen=True)
class TrajectoryCritic:
    r"""One equation for each episode, by ridge regression through their Gram matrix (section 3.2, "the critic").

    .. math:: \sum_t \gamma^t r_t = \langle w, \sum_t \gamma^t K(s_t, \cdot)\, u_t \rangle + V(s_0)

    One intercept, without a penalty, stands for :math:`V(s_0)`.

    Attributes:
        ridge: penalty on the squared norm of w, relative to the mean diagonal of the Gram matrix.
        ridge_norm: one of `RIDGE_NORMS`.
    """

    ridge: float
    ridge_norm: str = "norm"

    def fit(self, samples: Samples, discount: float) -> Array:
        """Return the coefficients of w, shape (m, n)."""
        features = samples.trajectory_features(discount)
        units = np.sqrt(ridge_scales(features, self.ridge_norm))
        scaled = features / units
        solution = relative_ridge_regression(scaled, samples.episodes.returns(discount), self.ridge)
        return samples.as_coefficients(solution / units)


@dataclass(frozen=True)
class StepPursuitCritic:
    """One equation at each step, by kernel matching pursuit after the values are taken off the returns.

    Attributes:
        ridge: penalty on the squared norm of w, as the step critic's.
        baseline: gives the advantages that w is fitted to.
    """

    ridge: float
    baseline: ValueBaseline

    def fit(self, samples: Samples, discount: float) -> Array:
        """Return the coefficients of w, shape (m, n)."""
        advantages = self.baseline.advantages(samples, discount)
        return _pursue_w(samples, _scores(samples), advantages, self.ridge)


@dataclass(frozen=True)
class TrajectoryPursuitCritic:
    """One equation for each episode, by kernel matching pursuit after their mean is taken off the returns.

    Attributes:
        ridge: penalty on the squared norm of w, with the steps' u in the units of the step critic.
    """

    ridge: float

    def fit(self, samples: Samples, discount: float) -> Array:
        """Return the coefficients of w, shape (m, n)."""
        features = samples.deviation * samples.trajectory_features(discount)
        returns = samples.episodes.returns(discount)
        return _pursue_w(samples, features.__getitem__, returns - returns.mean(), self.ridge)


def _scores(samples: Samples) -> Callable[[Rows], Array]:
    """Return what gives some samples' u times features, in the units of the step critic."""
    deviation = samples.deviation
    return lambda rows: deviation * samples.score_features_of(rows)


def _pursue_w(samples: Samples, rows: Callable[[slice], Array], targets: Array, ridge: float) -> Array:
    r"""Return the coefficients of :math:`w = \sum_j \beta_j K(s_j, \cdot)\, u_j` over at most m samples (Eq 11).

    Args:
        samples: samples of the iteration, among whose kernel functions is chosen.
        rows: from a slice of the equations for w to their left sides, shape (rows, m n).
        targets: their right sides, shape (equations,).
        ridge: penalty on the squared norm of w.
    """
    scores, (count, budget) = _scores(samples), samples.features.shape
    chosen, weights = pursue_atoms(rows, targets[:, None], scores, count, budget=budget, ridge=ridge)
    return samples.deviation * samples.as_coefficients(weights[:, 0] @ scores(chosen))
