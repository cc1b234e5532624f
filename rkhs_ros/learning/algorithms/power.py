"""PoWER: policy learning by weighting exploration with the returns (Kober and Peters, 2011), a parametric rival."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rkhs_ros.base.settings import setting
from rkhs_ros.learning.algorithms.algorithm import Experience, Update
from rkhs_ros.learning.algorithms.function_spaces import GridSettings
from rkhs_ros.learning.algorithms.weighted_exploration import WeightedExploration, weighted_regression
from rkhs_ros.learning.algorithms.weightings import WEIGHTINGS
from rkhs_ros.learning.samples import Samples
from rkhs_ros.policies.gaussian import GaussianPolicy
from rkhs_ros.rkhs.function import Function
from rkhs_ros.rkhs.kernels import Array

LEAST_SQUARED_LENGTH = 1e-12  # of a state's features, which vanish far from every centre


@dataclass(frozen=True)
class PoWER(GridSettings, WeightedExploration):
    r"""PoWER on a grid, with the best episodes so far used again.

    The exploration of the action stands for one of the parameters, :math:`\epsilon_t = \phi(s_t)^\top \varepsilon_t`.
    ``full`` weighs with the matrix :math:`W = \phi \phi^\top / g` of Kober and Peters:

    .. math:: \theta' = \theta + \Big(\sum_t q_t W_t + \lambda I\Big)^{-1} \sum_t q_t W_t\, \varepsilon_t
    """

    weighting: str = setting("returns", "how the exploration of a step is weighted", choices=tuple(WEIGHTINGS))
    reuse: int = setting(5, "best episodes so far that are learnt from again", minimum=0, maximum=10_000)
    solution: str = setting(
        "full", "the matrix W of Kober and Peters, or its diagonal, Eq 6", choices=("full", "diagonal")
    )

    def unused(self) -> set[str]:
        """Return the names of the settings of the regression too, where there is none."""
        return super().unused() | ({"ridge", "ridge_unit"} if self.solution == "diagonal" else set())

    def update(self, policy: GaussianPolicy, experience: Experience) -> Update:
        """Return the policy with new mean and variance."""
        samples = self.space.samples(policy, experience.episodes + experience.memory)  # phi, Eq 3
        q = self.weights(samples, experience.discount)
        if self.solution == "full":
            change = weighted_regression(samples, q, self.ridge, self.ridge_unit)  # the matrix W: Eq 23 in phi
        else:
            change = mean_exploration(samples, q)  # Eq 6
        return self.advance(policy, change, samples, q, experience)  # theta + change; the variance by Eq 24


def mean_exploration(samples: Samples, weights: Array) -> Function:
    r"""Return the change by the diagonal of W: the weighted mean of each parameter's own exploration (Eq 6).

    .. math:: \theta' - \theta = \sum_t q_t\, \varepsilon_t \Big/ \sum_t q_t, \qquad
        \varepsilon_t = \phi(s_t)\, \epsilon_t / |\phi(s_t)|^2

    Of all explorations of the parameters that explain the action's, that one is the least.

    Args:
        samples: samples of the iteration, and of the episodes remembered.
        weights: q, shape (samples,).
    """
    lengths = np.maximum(np.sum(samples.features**2, axis=1), LEAST_SQUARED_LENGTH)
    shares = weights[:, None] * samples.exploration / lengths[:, None]
    return samples.basis.function(samples.features.T @ shares / weights.sum())
