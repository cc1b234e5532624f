"""The steps of an iteration's episodes as matrices: kernel features, exploration, variance and time."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rkhs_ros.learning.episodes import Episodes
from rkhs_ros.policies.gaussian import GaussianPolicy
from rkhs_ros.rkhs.function import FixedBasis
from rkhs_ros.rkhs.kernels import Array
from rkhs_ros.rkhs.newton import NewtonBasis, pivoted_cholesky


@dataclass(frozen=True)
class Samples:
    r"""The steps of all episodes, one row each, in coordinates of the policy's function space.

    A function of the space is a matrix of m x n coefficients: :math:`w(s_i) = \phi_i^\top W` with the features phi.

    Attributes:
        episodes: the episodes, with the policy's inputs as observations.
        observations: s, shape (samples, d).
        mean: :math:`h(s)` of the policy, which did not act in reused episodes, shape (samples, n).
        exploration: :math:`a - h(s)`, shape (samples, n).
        variance: diagonal of Sigma of the policy, shape (samples, n).
        basis: basis functions of the coefficients.
        features: phi, the basis at the observations, shape (samples, m).
    """

    episodes: Episodes
    observations: Array
    mean: Array
    exploration: Array
    variance: Array
    basis: NewtonBasis | FixedBasis
    features: Array

    @classmethod
    def in_newton_basis(cls, policy: GaussianPolicy, episodes: Episodes, centres: int) -> Samples:
        """Return the samples in a Newton basis of at most ``centres`` centres, selected among the observations."""
        observations = episodes.flat(episodes.observations)
        chosen = pivoted_cholesky(policy.mean.kernel, observations, centres)
        basis = NewtonBasis.of(policy.mean.kernel, observations, chosen)
        return cls._in_basis(policy, episodes, basis, chosen.values)

    @classmethod
    def on_centres(cls, policy: GaussianPolicy, episodes: Episodes, centres: Array) -> Samples:
        """Return the samples in the basis of the kernel functions of given centres, shape (m, d)."""
        basis = FixedBasis(policy.mean.kernel, centres)
        return cls._in_basis(policy, episodes, basis, basis(episodes.flat(episodes.observations)))

    @classmethod
    def _in_basis(
        cls, policy: GaussianPolicy, episodes: Episodes, basis: NewtonBasis | FixedBasis, features: Array
    ) -> Samples:
        observations = episodes.flat(episodes.observations)
        mean, variance = policy.mean(observations), policy.variance(observations)
        return cls(episodes, observations, mean, episodes.flat(episodes.actions) - mean, variance, basis, features)

    @property
    def deviation(self) -> float:
        """Root mean square of the policy's standard deviation."""
        return float(np.sqrt(self.variance.mean()))

    @property
    def score(self) -> Array:
        r"""Vectors :math:`u = \Sigma^{-1}(a - h(s))` of Eq 8, shape (samples, n)."""
        return self.exploration / self.variance

    @property
    def deviation_scores(self) -> Array:
        r"""Gradient of the log policy along :math:`\sqrt2 \log\sigma`, shape (samples, n), with mean square 1.

        .. math:: (\epsilon^2 / \sigma^2 - 1) / \sqrt 2
        """
        return np.asarray((self.exploration**2 / self.variance - 1.0) / np.sqrt(2.0))

    @property
    def score_features(self) -> Array:
        r"""Gradient of the log policy, :math:`K(s, \cdot)\, u` (Eq 8), in coordinates, shape (samples, m n)."""
        outer = self.features[:, :, None] * self.score[:, None, :]
        return outer.reshape(len(outer), outer.shape[1] * outer.shape[2])

    def trajectory_features(self, discount: float) -> Array:
        r"""Return :math:`\sum_t \gamma^t K(s_t, \cdot)\, u_t` of each episode in coordinates, shape (N, m n)."""
        factors = discount ** self.episodes.steps[:, None]
        return np.add.reduceat(factors * self.score_features, self.episodes.begins, axis=0)

    def as_coefficients(self, coordinates: Array) -> Array:
        """Return the coordinates of a function, shape (m n,), as coefficients of the basis, shape (m, n)."""
        return coordinates.reshape(-1, self.exploration.shape[1])

    def compatible_advantages(self, w: Array) -> Array:
        r"""Return :math:`A(s, a) = \langle w, K(s, \cdot)\, u \rangle` (Eq 12) of each sample, shape (samples,).

        Args:
            w: coefficients, shape (m, n).
        """
        return np.asarray(np.sum(self.features @ w * self.score, axis=1))

    def policy_gradient(self, advantages: Array) -> Array:
        r"""Return the coefficients of :math:`\frac1N \sum_{i,t} A_{it} K(s_{it}, \cdot)\, u_{it}` (Eq 9), shape (m, n).

        Args:
            advantages: A, shape (samples,).
        """
        return np.asarray(self.features.T @ (self.score * advantages[:, None]) / len(self.episodes))

    @property
    def time_features(self) -> Array:
        """Features 1, t and t^2 with t in units of the horizon, shape (samples, 3)."""
        t = self.episodes.steps / self.episodes.horizon
        return np.stack([np.ones_like(t), t, t**2], axis=1)

    def rewards_to_go(self, discount: float) -> Array:
        r"""Return :math:`\sum_{k \ge t} \gamma^{k-t} r_k` of each sample, shape (samples,)."""
        return self.episodes.flat(self.episodes.rewards_to_go(discount))

    def lambda_returns(self, values: Array, discount: float, trace: float) -> Array:
        """Return the lambda returns of each sample from the values V of the samples, both of shape (samples,)."""
        by_step = np.zeros(self.episodes.mask.shape)
        by_step[self.episodes.mask] = values
        return self.episodes.flat(self.episodes.lambda_returns(by_step, discount, trace))
