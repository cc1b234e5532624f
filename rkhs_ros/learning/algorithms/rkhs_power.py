"""RKHS-PoWER: policy learning by weighting exploration with the returns, in RKHS (section 3.3 of the paper)."""

from dataclasses import dataclass

import numpy as np

from rkhs_ros.learning.algorithms.algorithm import Experience, Update
from rkhs_ros.learning.algorithms.function_spaces import Sparse
from rkhs_ros.learning.algorithms.weighted_exploration import WeightedExploration, weighted_regression
from rkhs_ros.learning.samples import Samples
from rkhs_ros.policies.gaussian import GaussianPolicy
from rkhs_ros.rkhs.function import Function
from rkhs_ros.rkhs.kernels import Array


@dataclass(frozen=True)
class RKHSPoWER(Sparse, WeightedExploration):
    r"""PoWER in the RKHS: weighted kernel regression of the exploration :math:`\epsilon = a - h(s)`.

    .. math:: h' = h + \arg\min_f \sum_t q_t |f(s_t) - \epsilon_t|^2 / g(s_t) + \lambda |f|^2
    """

    def update(self, policy: GaussianPolicy, experience: Experience) -> Update:
        """Return the policy with new mean and variance."""
        samples = self.samples(policy, experience.episodes + experience.memory)
        if self.weighting == "as_published":
            q = self.value_baseline.advantages(samples, experience.discount)  # A, signed
            change = published_regression(samples, q, self.ridge)  # Eq 23 as published
        else:
            q = self.weights(samples, experience.discount)
            change = weighted_regression(samples, q, self.ridge, relative=not self.learns_variance)  # Eq 23, corrected
        return self.advance(policy, change, samples, q)  # h + change; the variance by Eq 24


def published_regression(samples: Samples, advantages: Array, ridge: float) -> Function:
    r"""Return h' - h by Eq 23 as published, over all samples and with signed advantages.

    .. math:: \alpha = (\lambda A_1^{-1} + \Gamma)^{-1} \epsilon = (\lambda I + A_1 \Gamma)^{-1} A_1 \epsilon, \qquad
        A_1 = \mathrm{diag}(A / g)

    Args:
        samples: samples of the iteration and of the reused episodes.
        advantages: A, shape (samples,).
        ridge: lambda.
    """
    kernel, points = samples.basis.kernel, samples.observations
    gram = kernel(points, points)

    def alpha(signed: Array, exploration: Array) -> Array:
        system = ridge * np.eye(len(gram)) + signed[:, None] * gram
        return np.asarray(np.linalg.solve(system, signed * exploration))

    columns = zip(samples.exploration.T, samples.variance.T, strict=True)
    return Function(kernel, points, np.stack([alpha(advantages / g, e) for e, g in columns], axis=1))
