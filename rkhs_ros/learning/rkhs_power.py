"""RKHS-PoWER: policy learning by weighting exploration with the returns, in RKHS (section 3.3 of the paper)."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from rkhs_ros.learning.algorithm import Algorithm, Metrics, measure
from rkhs_ros.learning.critics import value
from rkhs_ros.learning.episodes import Episodes
from rkhs_ros.learning.features import Samples, ridge_regression
from rkhs_ros.policies.gaussian import GaussianPolicy
from rkhs_ros.policies.variance import KernelVariance
from rkhs_ros.rkhs.kernels import Array
from rkhs_ros.rkhs.settings import setting


@dataclass(frozen=True)
class RKHSPoWER(Algorithm):
    r"""EM-inspired update without a step size: weighted kernel regression of the exploration (Eq 23).

    .. math:: h' = h + \sum_t \kappa(s_t, \cdot)\,\alpha_t, \qquad
        \alpha = D (D \Gamma D + \lambda I)^{-1} D \epsilon, \qquad D = \mathrm{diag}\sqrt{q / g}

    solved on the dictionary of the centres. The weights :math:`q = \max(\sum_{k \ge t} \gamma^{k-t} r_k - V, 0)` have
    mean 1: signed advantages, as printed, make the system indefinite.
    """

    ridge: float = setting(1.0, "penalty lambda on the step's squared norm in the RKHS", minimum=1e-12, maximum=1e6)
    value_ridge: float = setting(0.01, "penalty on the value's squared norm in the RKHS", minimum=1e-12, maximum=1e6)
    sd_minimum: float = setting(0.05, "least standard deviation learnt, in units of action", minimum=1e-6, maximum=1e6)
    sd_maximum: float = setting(4.0, "greatest standard deviation learnt", minimum=1e-6, maximum=1e6)

    def __post_init__(self) -> None:
        """Raise ValueError where the bounds of the standard deviation are crossed."""
        if self.sd_minimum > self.sd_maximum:
            raise ValueError(f"algorithm.sd_minimum: expected at most {self.sd_maximum}, got {self.sd_minimum}")

    def update(self, policy: GaussianPolicy, episodes: Episodes, discount: float) -> tuple[GaussianPolicy, Metrics]:
        """Return the policy with new mean and variance."""
        samples = Samples.of(policy, episodes, self.centres)
        weights = self._weights(samples, discount)
        columns = zip(samples.exploration.T, samples.variance.T, strict=True)
        coefficients = np.stack([self._regress(samples, weights / g, e) for e, g in columns], axis=1)  # Eq 23
        step = samples.basis.function(coefficients)
        moved, error = self.move(policy, step, samples.observations)
        new = replace(moved, variance=self._variance(samples, weights))  # Eq 24
        return new, measure(policy, new, samples.observations, 1.0, error)

    def _weights(self, samples: Samples, discount: float) -> Array:
        reward_to_go = samples.episodes.flat(samples.episodes.rewards_to_go(discount))
        advantage = np.maximum(reward_to_go - value(samples, discount, self.value_ridge), 0.0)
        mean = advantage.mean()
        return advantage / mean if mean > 0 else np.ones_like(advantage)

    def _regress(self, samples: Samples, weights: Array, exploration: Array) -> Array:
        penalty = np.full(samples.features.shape[1], self.ridge / len(weights))
        return ridge_regression(samples.features, exploration[:, None], penalty, weights)[:, 0]

    def _variance(self, samples: Samples, weights: Array) -> KernelVariance:
        """Return the weighted mean of squared exploration, each sample moved to its nearest centre."""
        kernel, centres = samples.basis.kernel, samples.basis.centres
        nearest = kernel(samples.observations, centres).argmax(axis=1)
        mass = np.bincount(nearest, weights, len(centres))
        squares = (weights[:, None] * samples.exploration**2).T
        sums = np.stack([np.bincount(nearest, column, len(centres)) for column in squares], axis=1)
        used = mass > 1e-9 * mass.max()
        bounds = np.ones(samples.exploration.shape[1])
        return KernelVariance(
            kernel,
            centres[used],
            mass[used],
            sums[used] / mass[used, None],
            minimum=self.sd_minimum**2 * bounds,
            maximum=self.sd_maximum**2 * bounds,
        )
