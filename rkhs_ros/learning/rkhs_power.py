"""RKHS-PoWER: policy learning by weighting exploration with the returns, in RKHS (section 3.3 of the paper)."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from rkhs_ros.base.settings import setting
from rkhs_ros.learning.algorithm import Algorithm, Experience, Update, measure
from rkhs_ros.learning.critics import advantages
from rkhs_ros.learning.episodes import Episodes
from rkhs_ros.learning.features import Samples, ridge_regression
from rkhs_ros.learning.spaces import Sparse
from rkhs_ros.learning.variances import VARIANCES
from rkhs_ros.learning.weightings import WEIGHTINGS, normalised
from rkhs_ros.policies.gaussian import GaussianPolicy
from rkhs_ros.policies.variance import Variance
from rkhs_ros.rkhs.function import Function
from rkhs_ros.rkhs.kernels import Array


@dataclass(frozen=True)
class WeightedExploration(Algorithm):
    r"""EM-inspired update without a step size: weighted kernel regression of the exploration (Eq 23).

    .. math:: h' = h + \sum_t \kappa(s_t, \cdot)\,\alpha_t, \qquad
        \alpha = D (D \Gamma D + \lambda I)^{-1} D \epsilon, \qquad D = \mathrm{diag}\sqrt{q / g}

    solved on the dictionary of the centres. The weights q are not negative and have mean 1: signed advantages, as
    printed, make the system indefinite.
    """

    weighting: str = setting("positive", "how the exploration of a step is weighted", choices=tuple(WEIGHTINGS))
    ridge: float = setting(1.0, "penalty lambda on the step's squared norm in the RKHS", minimum=1e-12, maximum=1e6)
    value_ridge: float = setting(0.01, "penalty on the value's squared norm in the RKHS", minimum=1e-12, maximum=1e6)
    reuse: int = setting(0, "best episodes so far that are learnt from again", minimum=0, maximum=10_000)
    variance: str = setting(
        "learnt",
        "how the exploration changes: learnt by Eq 24 as mended, constant but for its decay, or as Eq 24 is printed",
        choices=("constant", *VARIANCES),
    )
    sd_minimum: float = setting(0.05, "least standard deviation learnt, in units of action", minimum=1e-6, maximum=1e6)
    sd_maximum: float = setting(4.0, "greatest standard deviation learnt", minimum=1e-6, maximum=1e6)

    def __post_init__(self) -> None:
        """Raise ValueError where the bounds of the standard deviation are crossed."""
        if self.sd_minimum > self.sd_maximum:
            raise ValueError(f"algorithm.sd_minimum: expected at most {self.sd_maximum}, got {self.sd_minimum}")

    def update(self, policy: GaussianPolicy, experience: Experience) -> Update:
        """Return the policy with new mean and variance."""
        episodes = experience.episodes + experience.memory
        samples = self.samples(policy, episodes)
        weights = self.weights(samples, experience.discount)
        moved, error = self.move(policy, self.mean_step(samples, weights), samples.observations)  # Eq 23
        new = replace(moved, variance=self._next_variance(policy, samples, weights))  # Eq 24
        metrics = measure(policy, new, samples.observations, 1.0, error)
        return Update(new, metrics, self._best(episodes, experience.discount))

    def weights(self, samples: Samples, discount: float) -> Array:
        """Return q of each sample, shape (samples,)."""
        return normalised(WEIGHTINGS[self.weighting](samples, discount, self.value_ridge))

    def mean_step(self, samples: Samples, weights: Array) -> Function:
        """Return h' - h."""
        columns = zip(samples.exploration.T, samples.variance.T, strict=True)
        penalty = np.full(samples.features.shape[1], self.ridge / len(weights))
        coefficients = [ridge_regression(samples.features, e[:, None], penalty, weights / g) for e, g in columns]
        return samples.basis.function(np.concatenate(coefficients, axis=1))

    def _next_variance(self, policy: GaussianPolicy, samples: Samples, weights: Array) -> Variance:
        if self.variance == "constant":
            return self.decayed(policy)
        if len(samples.basis.centres) == 0:  # as of a homogeneous kernel at nothing but 0
            return policy.variance
        return VARIANCES[self.variance](samples, weights, self.sd_minimum, self.sd_maximum)

    def _best(self, episodes: Episodes, discount: float) -> Episodes:
        order = np.argsort(-episodes.returns(discount), kind="stable")
        return episodes.take(order[: self.reuse])


@dataclass(frozen=True)
class RKHSPoWER(Sparse, WeightedExploration):
    r"""PoWER in the RKHS.

    With the weighting ``printed`` the system of Eq 23 is solved to the letter, over all samples and with signed
    advantages :math:`A_1 = \mathrm{diag}(A / g)`:

    .. math:: \alpha = (\lambda A_1^{-1} + \Gamma)^{-1} \epsilon = (\lambda I + A_1 \Gamma)^{-1} A_1 \epsilon
    """

    weighting: str = setting("positive", "how the exploration of a step is weighted", choices=(*WEIGHTINGS, "printed"))

    def weights(self, samples: Samples, discount: float) -> Array:
        """Return q of each sample, shape (samples,); signed as printed."""
        if self.weighting == "printed":
            return advantages(samples, discount, self.value_ridge)
        return super().weights(samples, discount)

    def mean_step(self, samples: Samples, weights: Array) -> Function:
        """Return h' - h."""
        if self.weighting != "printed":
            return super().mean_step(samples, weights)
        kernel = samples.basis.kernel
        gram = kernel(samples.observations, samples.observations)
        columns = zip(samples.exploration.T, samples.variance.T, strict=True)
        return Function(
            kernel, samples.observations, np.stack([self._printed(gram, weights / g, e) for e, g in columns], 1)
        )

    def _printed(self, gram: Array, signed: Array, exploration: Array) -> Array:
        system = self.ridge * np.eye(len(gram)) + signed[:, None] * gram
        return np.asarray(np.linalg.solve(system, signed * exploration))
