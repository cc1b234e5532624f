"""PoWER: policy learning by weighting exploration with the returns (Kober and Peters, 2011), a parametric baseline."""

from dataclasses import dataclass

import numpy as np

from rkhs_ros.base.settings import setting
from rkhs_ros.learning.algorithms.algorithm import Experience, Update
from rkhs_ros.learning.algorithms.function_spaces import Grid
from rkhs_ros.learning.algorithms.weighted_exploration import (
    WeightedExploration,
    weighted_regression,
    weighting_setting,
)
from rkhs_ros.learning.samples import Samples
from rkhs_ros.policies.gaussian import GaussianPolicy
from rkhs_ros.rkhs.function import Function
from rkhs_ros.rkhs.kernels import Array

LEAST_SQUARED_LENGTH = 1e-12  # avoids division by zero, because features vanish far from every centre


@dataclass(frozen=True)
class PoWER(Grid, WeightedExploration):
    r"""PoWER on a grid of centres, with reuse of the best episodes so far.

    Exploration noise of the actions stands for exploration noise of the parameters,
    :math:`\epsilon_t = \phi(s_t)^\top \varepsilon_t`.
    The update uses the matrix :math:`W = \phi \phi^\top / g` of Kober and Peters:

    .. math:: \theta' = \theta + \Big(\sum_t q_t W_t + \lambda I\Big)^{-1} \sum_t q_t W_t\, \varepsilon_t
    """

    weighting: str = weighting_setting("returns")
    reuse: int = setting(5, "number of best episodes so far that the next update reuses", minimum=0, maximum=10_000)

    def update(self, policy: GaussianPolicy, experience: Experience) -> Update:
        """Return the policy with new mean and variance."""
        samples = self.samples(policy, experience.episodes + experience.memory)  # phi, Eq 3
        q = self.weights(samples, experience.discount)
        if self.weighting == "as_published":
            change = mean_exploration(samples, q)  # Eq 6
        else:  # the matrix W: Eq 23 in phi
            change = weighted_regression(samples, q, self.ridge, relative=not self.learns_variance)
        return self.advance(policy, change, samples, q)  # theta + change; the variance by Eq 24


def mean_exploration(samples: Samples, weights: Array) -> Function:
    r"""Return the change for the diagonal of W: the weighted mean of each parameter's exploration (Eq 6).

    .. math:: \theta' - \theta = \sum_t q_t\, \varepsilon_t \Big/ \sum_t q_t, \qquad
        \varepsilon_t = \phi(s_t)\, \epsilon_t / |\phi(s_t)|^2

    This is the smallest exploration of the parameters that explains the exploration of the action.

    Args:
        samples: samples of the iteration and of the reused episodes.
        weights: q, shape (samples,).
    """
    lengths = np.maximum(np.sum(samples.features**2, axis=1), LEAST_SQUARED_LENGTH)
    shares = weights[:, None] * samples.exploration / lengths[:, None]
    return samples.basis.function(samples.features.T @ shares / weights.sum())
