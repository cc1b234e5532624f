"""The samples of an iteration in coordinates: kernel functions of a few centres, orthonormal in the RKHS."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from rkhs_ros.learning.episodes import Episodes
from rkhs_ros.policies.gaussian import GaussianPolicy
from rkhs_ros.rkhs.fixed import FixedBasis
from rkhs_ros.rkhs.kernels import Array
from rkhs_ros.rkhs.newton import NewtonBasis, pivoted_cholesky


@dataclass(frozen=True)
class Samples:
    """All steps of all episodes in the policy's space.

    Attributes:
        episodes: where they come from.
        observations: shape (samples, d).
        exploration: :math:`a - h(s)`, shape (samples, n).
        variance: of the policy that acted, shape (samples, n).
        basis: functions that the coordinates belong to.
        features: the basis at the observations, shape (samples, m).
    """

    episodes: Episodes
    observations: Array
    exploration: Array
    variance: Array
    basis: NewtonBasis | FixedBasis
    features: Array

    @classmethod
    def of(cls, policy: GaussianPolicy, episodes: Episodes, centres: int) -> Samples:
        """Take the Newton basis of at most that many centres, chosen among the observations."""
        observations = episodes.flat(episodes.observations)
        chosen = pivoted_cholesky(policy.mean.kernel, observations, centres)
        return cls._of(policy, episodes, NewtonBasis.of(policy.mean.kernel, observations, chosen), chosen.values)

    @classmethod
    def on(cls, policy: GaussianPolicy, episodes: Episodes, centres: Array) -> Samples:
        """Take the kernel functions of given centres, shape (m, d), as they are."""
        basis = FixedBasis(policy.mean.kernel, centres)
        return cls._of(policy, episodes, basis, basis(episodes.flat(episodes.observations)))

    @classmethod
    def _of(
        cls, policy: GaussianPolicy, episodes: Episodes, basis: NewtonBasis | FixedBasis, features: Array
    ) -> Samples:
        observations = episodes.flat(episodes.observations)
        exploration = episodes.flat(episodes.actions) - policy.mean(observations)
        return cls(episodes, observations, exploration, policy.variance(observations), basis, features)

    @property
    def score(self) -> Array:
        r"""Coefficients :math:`u = \Sigma^{-1}(a - h(s))` of Eq 8, shape (samples, n)."""
        return self.exploration / self.variance

    @property
    def score_features(self) -> Array:
        r"""Coordinates of :math:`K(s, \cdot)\, u`, Eq 8, shape (samples, m n)."""
        outer = self.features[:, :, None] * self.score[:, None, :]
        return outer.reshape(len(outer), -1)

    @property
    def time_features(self) -> Array:
        """The span of 1, t, t^2 with t in units of the horizon, shape (samples, 3)."""
        t = self.episodes.steps / self.episodes.horizon
        return np.stack([np.ones_like(t), t, t**2], axis=1)


def ridge_regression(features: Array, targets: Array, penalty: Array, weights: Array | None = None) -> Array:
    r"""Minimise :math:`\frac1n \sum_i q_i |\phi_i \theta - y_i|^2 + \sum_j \lambda_j |\theta_j|^2`.

    Args:
        features: rows phi, shape (n, p).
        targets: shape (n, k).
        penalty: lambda, shape (p,), positive.
        weights: q, shape (n,); all 1 where None.

    Returns:
        The coefficients theta, shape (p, k).
    """
    n, p = features.shape
    if n < p:
        return _dual_ridge_regression(features, targets, penalty, np.ones(n) if weights is None else weights)
    weighted = features if weights is None else features * weights[:, None]
    normal = weighted.T @ features / n + np.diag(penalty)
    return np.asarray(cho_solve(cho_factor(normal, check_finite=False), weighted.T @ targets / n))


def _dual_ridge_regression(features: Array, targets: Array, penalty: Array, weights: Array) -> Array:
    """Solve the same problem through the n x n Gram, where there are more features than rows."""
    root = np.sqrt(weights / len(features))[:, None]
    scaled = root * features / penalty
    gram = scaled @ (root * features).T + np.eye(len(features))
    return np.asarray(scaled.T @ cho_solve(cho_factor(gram, check_finite=False), root * targets))
