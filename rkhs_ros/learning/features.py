"""The samples of an iteration in coordinates: kernel functions of a few centres, orthonormal in the RKHS."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from rkhs_ros.learning.episodes import Episodes
from rkhs_ros.policies.gaussian import GaussianPolicy
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
        basis: Newton basis on centres chosen among the observations.
        features: the basis at the observations, shape (samples, m).
    """

    episodes: Episodes
    observations: Array
    exploration: Array
    variance: Array
    basis: NewtonBasis
    features: Array

    @classmethod
    def of(cls, policy: GaussianPolicy, episodes: Episodes, centres: int) -> Samples:
        """Choose at most that many centres and evaluate policy and basis at the samples."""
        observations = episodes.flat(episodes.observations)
        chosen = pivoted_cholesky(policy.mean.kernel, observations, centres)
        return cls(
            episodes,
            observations,
            episodes.flat(episodes.actions) - policy.mean(observations),
            policy.variance(observations),
            NewtonBasis.of(policy.mean.kernel, observations, chosen),
            chosen.values,
        )

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
    weighted = features if weights is None else features * weights[:, None]
    normal = weighted.T @ features / len(features) + np.diag(penalty)
    return np.asarray(cho_solve(cho_factor(normal, check_finite=False), weighted.T @ targets / len(features)))
