"""The Gaussian policy with mean and variance in reproducing kernel Hilbert spaces."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from rkhs_ros.policies.streams import Batch
from rkhs_ros.policies.variance import KernelVariance, Variance
from rkhs_ros.rkhs.function import Function
from rkhs_ros.rkhs.kernels import Array
from rkhs_ros.rkhs.validation import require


@dataclass(frozen=True)
class GaussianPolicy:
    r"""The policy :math:`a \sim N(h(s), \Sigma(s))` with diagonal :math:`\Sigma` (Eq 2).

    Attributes:
        mean: the function h.
        variance: the diagonal of Sigma.
    """

    mean: Function
    variance: Variance

    def __post_init__(self) -> None:
        """Raise ValueError where mean and variance differ in their dimensions."""
        require(
            self.mean.output_dim == self.variance.output_dim,
            "variance",
            f"{self.mean.output_dim} action dimensions, as the mean has",
            self.variance.output_dim,
        )
        if isinstance(self.variance, KernelVariance):
            d = self.mean.input_dim
            require(self.variance.input_dim == d, "variance centres", f"{d} columns", self.variance.input_dim)

    def act(self, observations: Array, exploration: Array) -> Array:
        """Return actions, shape (batch, n), from standard normal draws of that shape."""
        return self.mean(observations) + np.sqrt(self.variance(observations)) * exploration

    def score(self, observations: Array, actions: Array) -> Array:
        r"""Return the coefficients :math:`u = \Sigma^{-1}(a - h(s))`, shape (batch, n), of Eq 8."""
        return (actions - self.mean(observations)) / self.variance(observations)

    def log_prob(self, observations: Array, actions: Array) -> Array:
        """Return the log density of actions, shape (batch, n), in their states: shape (batch,)."""
        variance = self.variance(observations)
        squares = (actions - self.mean(observations)) ** 2 / variance
        return np.asarray(-0.5 * np.sum(squares + np.log(2 * np.pi * variance), axis=1))

    def with_mean(self, mean: Function) -> GaussianPolicy:
        """Return the policy with another mean."""
        return replace(self, mean=mean)


def mean_kl(old: GaussianPolicy, new: GaussianPolicy, observations: Array) -> float:
    r"""Return the mean over states of :math:`KL(\pi_{old} \| \pi_{new})`, in nats."""
    before, after = old.variance(observations), new.variance(observations)
    squares = (old.mean(observations) - new.mean(observations)) ** 2
    terms = np.log(after / before) + (before + squares) / after - 1.0
    return float(0.5 * terms.sum(axis=1).mean())


@dataclass(frozen=True)
class Acting:
    """A policy that acts through the steps of one batch of episodes.

    A pure function of step and observations, so that a step asked for twice is answered alike.

    Attributes:
        policy: the policy, the same throughout the batch.
        exploration: standard normal draws, shape (rows, horizon, n), or None to act by the mean.
    """

    policy: GaussianPolicy
    exploration: Array | None

    @classmethod
    def start(cls, policy: GaussianPolicy, batch: Batch) -> Acting:
        """Begin a batch."""
        return cls(policy, batch.exploration(policy.mean.output_dim) if batch.explore else None)

    def __call__(self, step: int, observations: Array) -> Array:
        """Return the actions of a step, shape (rows, n)."""
        if self.exploration is None:
            return self.policy.mean(observations)
        return self.policy.act(observations, self.exploration[:, step])
