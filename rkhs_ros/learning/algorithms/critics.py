r"""Critics estimate the natural gradient w by regression of returns on the gradient of the log policy.

They assume that the advantage is compatible with the policy, that is, linear in the same features (Eq 12):

.. math:: A(s, a) = \langle w, K(s, \cdot)\, u \rangle, \qquad u = \Sigma^{-1} (a - h(s))

Then w is the natural gradient. A critic has one equation per step or per episode, and solves its equations by ridge
regression or by kernel matching pursuit. It returns coefficients in the samples' basis. In a Newton basis, the squared
norm of the coefficients is the squared RKHS norm of the function. In the coordinates of a linear kernel, ridges weight
each squared coefficient by the mean square of its column, so the scale of the coordinates has no effect.
"""

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from rkhs_ros.learning.samples import Rows, Samples
from rkhs_ros.rkhs.kernels import LINEAR, Array
from rkhs_ros.rkhs.pursuit import pursue_atoms
from rkhs_ros.rkhs.regression import by_blocks, relative_ridge_regression, ridge_regression_by_blocks

TREND_RIDGE = 1e-6  # penalty on the coefficients of 1, t and t^2, negligibly small


class Critic(Protocol):
    """An estimator of the natural gradient."""

    def fit(self, samples: Samples, discount: float) -> Array:
        """Return the coefficients of w, shape (m, n).

        Args:
            samples: samples of the iteration.
            discount: discount factor gamma of the return.
        """


def ridge_scales(samples: Samples, columns: Array) -> Array:
    """Return the weight of each squared coefficient in the ridge penalty, shape (p,), for columns of shape (n, p)."""
    if samples.basis.kernel != LINEAR:
        return np.ones(columns.shape[1])
    squares = np.mean(columns**2, axis=0)
    return np.where(squares > 0, squares, 1.0)


@dataclass(frozen=True)
class ValueBaseline:
    r"""A value baseline: a function of the state plus a trend over time, fitted to the rewards to go.

    .. math:: \sum_{k \ge t} \gamma^{k-t} r_k = V(s_t) + (1, t, t^2)\, \beta

    Attributes:
        ridge: penalty on the squared norm of V.
        trace: lambda of the returns. Below 1, the returns contain less noise of distant steps, but are biased by the
            error of the values; at 1 they are the rewards to go.
    """

    ridge: float
    trace: float = 1.0

    def values(self, samples: Samples, discount: float) -> Array:
        """Return the values, including the trend, of each sample, shape (samples,)."""
        time_features, returns = samples.time_features, samples.rewards_to_go(discount)

        def columns(rows: slice) -> Array:
            return np.concatenate([samples.features[rows], time_features[rows]], axis=1)

        solution = ridge_regression_by_blocks(columns, returns[:, None], self.penalty(samples))
        return by_blocks(lambda rows: np.asarray(columns(rows) @ solution[:, 0]), len(returns))

    def returns(self, samples: Samples, discount: float) -> Array:
        """Return the lambda returns of each sample, shape (samples,)."""
        if self.trace == 1.0:  # independent of the values
            return samples.rewards_to_go(discount)
        return samples.lambda_returns(self.values(samples, discount), discount, self.trace)

    def advantages(self, samples: Samples, discount: float) -> Array:
        """Return the lambda returns minus the values of each sample, shape (samples,)."""
        values = self.values(samples, discount)
        if self.trace == 1.0:
            return np.asarray(samples.rewards_to_go(discount) - values)
        return np.asarray(samples.lambda_returns(values, discount, self.trace) - values)

    def penalty(self, samples: Samples) -> Array:
        """Return the penalties on the coefficients of V, followed by those of the trend, shape (m + 3,)."""
        state = self.ridge * ridge_scales(samples, samples.features)
        return np.concatenate([state, np.full(samples.time_features.shape[1], TREND_RIDGE)])


@dataclass(frozen=True)
class StepCritic:
    r"""A critic with one equation per step, solved by joint ridge regression for w, V and the trend (after Eq 12).

    .. math:: \sum_{k \ge t} \gamma^{k-t} r_k = \langle w, K(s_t, \cdot)\, u_t \rangle + V(s_t) + (1, t, t^2)\, \beta

    It has much less variance than a critic with one equation per episode. The :math:`u_t` are multiplied by the
    policy's standard deviation, so that the effect of the ridge does not depend on the variance.

    Attributes:
        ridge: penalty on the squared norm of w in these units.
        baseline: V and the trend; its lambda returns are the left-hand side.
    """

    ridge: float
    baseline: ValueBaseline

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
        """Return the weight of each squared coefficient of w in the penalty, shape (m n,)."""
        if samples.basis.kernel != LINEAR:  # avoids the score features of all samples at once
            return np.ones(samples.features.shape[1] * samples.exploration.shape[1])
        return ridge_scales(samples, samples.deviation * samples.score_features)


@dataclass(frozen=True)
class TrajectoryCritic:
    r"""A critic with one equation per episode, solved by ridge regression (section 3.2, "the critic").

    .. math:: \sum_t \gamma^t r_t = \langle w, \sum_t \gamma^t K(s_t, \cdot)\, u_t \rangle + V(s_0)

    An intercept without a penalty represents :math:`V(s_0)`.

    Attributes:
        ridge: penalty on the squared norm of w, relative to the mean diagonal of the Gram matrix.
    """

    ridge: float

    def fit(self, samples: Samples, discount: float) -> Array:
        """Return the coefficients of w, shape (m, n)."""
        features = samples.trajectory_features(discount)
        units = np.sqrt(ridge_scales(samples, features))
        scaled = features / units
        solution = relative_ridge_regression(scaled, samples.episodes.returns(discount), self.ridge)
        return samples.as_coefficients(solution / units)


@dataclass(frozen=True)
class PursuitCritic:
    r"""A critic with one equation per step, solved by kernel matching pursuit for the returns minus the values.

    It returns :math:`w = \sum_j \beta_j K(s_j, \cdot)\, u_j` over at most m samples (Eq 11).

    Attributes:
        ridge: penalty on the squared norm of w, in the units of the step critic.
        baseline: provides the advantages to which w is fitted.
    """

    ridge: float
    baseline: ValueBaseline

    def fit(self, samples: Samples, discount: float) -> Array:
        """Return the coefficients of w, shape (m, n)."""
        advantages = self.baseline.advantages(samples, discount)
        deviation, (count, budget) = samples.deviation, samples.features.shape

        def scores(rows: Rows) -> Array:  # in the units of the step critic
            return deviation * samples.score_features_of(rows)

        chosen, weights = pursue_atoms(scores, advantages[:, None], scores, count, budget=budget, ridge=self.ridge)
        return deviation * samples.as_coefficients(weights[:, 0] @ scores(chosen))
