"""PoWER: policy learning by weighting exploration with the returns (Kober and Peters, 2011), a parametric rival."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rkhs_ros.base.settings import setting
from rkhs_ros.learning.features import Samples
from rkhs_ros.learning.rkhs_power import WeightedExploration
from rkhs_ros.learning.spaces import OnGrid
from rkhs_ros.learning.weightings import WEIGHTINGS
from rkhs_ros.rkhs.function import Function
from rkhs_ros.rkhs.kernels import Array

NOTHING = 1e-12  # squared length of the features of a state that no centre is near


@dataclass(frozen=True)
class PoWER(OnGrid, WeightedExploration):
    r"""PoWER on a grid, with the best episodes so far used again.

    The exploration of the action stands for one of the parameters, :math:`\epsilon_t = \phi(s_t)^\top \varepsilon_t`.
    ``full`` weighs with the matrix :math:`W = \phi \phi^\top / g` of Kober and Peters:

    .. math:: \theta' = \theta + \Big(\sum_t q_t W_t + \lambda I\Big)^{-1} \sum_t q_t W_t\, \varepsilon_t

    ``diagonal`` is Eq 6: each parameter goes to the weighted mean of its own exploration, the least that explains
    the action's, :math:`\varepsilon_t = \phi(s_t)\, \epsilon_t / |\phi(s_t)|^2`.
    """

    weighting: str = setting("returns", "how the exploration of a step is weighted", choices=tuple(WEIGHTINGS))
    reuse: int = setting(5, "best episodes so far that are learnt from again", minimum=0, maximum=10_000)
    solution: str = setting(
        "full", "the matrix W of Kober and Peters, or its diagonal, Eq 6", choices=("full", "diagonal")
    )

    def mean_step(self, samples: Samples, weights: Array) -> Function:
        """Return the step of the weights as a function."""
        if self.solution == "full":
            return super().mean_step(samples, weights)
        lengths = np.maximum(np.sum(samples.features**2, axis=1), NOTHING)
        shares = weights[:, None] * samples.exploration / lengths[:, None]
        return samples.basis.function(samples.features.T @ shares / weights.sum())  # Eq 6
