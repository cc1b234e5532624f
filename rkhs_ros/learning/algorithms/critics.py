r"""Critics estimate the natural gradient w by regression of returns on the gradient of the log policy.

They assume that the advantage is compatible with the policy, that is, linear in the same features (Eq 12):

.. math:: A(s, a) = \langle w, K(s, \cdot)\, u \rangle, \qquad u = \Sigma^{-1} (a - h(s))

Then w is the natural gradient. A critic has one equation per step or per episode, and solves its equations by ridge
regression or by kernel matching pursuit. It returns coefficients in the samples' basis. In a Newton basis, the squared
norm of the coefficients is the squared RKHS norm of the function. In the coordinates of a linear kernel, ridge
regression weights each squared coefficient by the mean square of its column, so their scale has no effect.
"""

from dataclasses import dataclass

import numpy as np

from rkhs_ros.learning.samples import Samples
from rkhs_ros.rkhs.kernels import LINEAR, Array
from rkhs_ros.rkhs.pursuit import pursue_atoms
from rkhs_ros.rkhs.regression import relative_ridge_regression, ridge_regression

TREND_RIDGE = 1e-6  # penalty on the coefficients of 1, t and t^2, negligibly small


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
        columns = np.concatenate([samples.features, samples.time_features], axis=1)
        returns = samples.rewards_to_go(discount)
        solution = ridge_regression(columns, returns[:, None], self.penalty(samples))
        return np.asarray(columns @ solution[:, 0])

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


def step_critic(samples: Samples, discount: float, ridge: float, baseline: ValueBaseline) -> Array:
    r"""Return w by one equation per step, a joint ridge regression for w, V and the trend (after Eq 12).

    .. math:: \sum_{k \ge t} \gamma^{k-t} r_k = \langle w, K(s_t, \cdot)\, u_t \rangle + V(s_t) + (1, t, t^2)\, \beta

    It has much less variance than a critic with one equation per episode. The :math:`u_t` are multiplied by the
    policy's standard deviation, so that the effect of the ridge does not depend on the variance.

    Args:
        samples: samples of the iteration.
        discount: discount factor gamma of the return.
        ridge: penalty on the squared norm of w in these units.
        baseline: V and the trend; its lambda returns are the left-hand side.

    Returns:
        The coefficients of w, shape (m, n).
    """
    scores = samples.deviation * samples.score_features
    columns = np.concatenate([scores, samples.features, samples.time_features], axis=1)
    penalty = np.concatenate([ridge * ridge_scales(samples, scores), baseline.penalty(samples)])
    solution = ridge_regression(columns, baseline.returns(samples, discount)[:, None], penalty)
    return samples.deviation * samples.as_coefficients(solution[: scores.shape[1]])


def trajectory_critic(samples: Samples, discount: float, ridge: float) -> Array:
    r"""Return w by ridge regression with one equation per episode (section 3.2, "the critic"), shape (m, n).

    .. math:: \sum_t \gamma^t r_t = \langle w, \sum_t \gamma^t K(s_t, \cdot)\, u_t \rangle + V(s_0)

    An intercept without a penalty represents :math:`V(s_0)`. The ridge is relative to the mean diagonal of the Gram
    matrix.
    """
    features = samples.trajectory_features(discount)
    units = np.sqrt(ridge_scales(samples, features))
    solution = relative_ridge_regression(features / units, samples.episodes.returns(discount), ridge)
    return samples.as_coefficients(solution / units)


def pursuit_critic(samples: Samples, discount: float, ridge: float, baseline: ValueBaseline) -> Array:
    r"""Return w by kernel matching pursuit for the returns minus the values, with one equation per step, shape (m, n).

    It is :math:`w = \sum_j \beta_j K(s_j, \cdot)\, u_j` over at most m samples (Eq 11). The ridge has the units of the
    step critic.
    """
    scores, targets = samples.deviation * samples.score_features, baseline.advantages(samples, discount)
    chosen, weights = pursue_atoms(scores, targets[:, None], scores, budget=samples.features.shape[1], ridge=ridge)
    return samples.deviation * samples.as_coefficients(weights[:, 0] @ scores[chosen])
