"""Imitation: a policy fitted to what was shown, by kernel matching pursuit; a warm start for any algorithm."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rkhs_ros.base.settings import Settings, build, setting
from rkhs_ros.base.validation import require
from rkhs_ros.learning.episodes import Episodes
from rkhs_ros.learning.kernel_choice import KernelChoice
from rkhs_ros.policies.gaussian import GaussianPolicy
from rkhs_ros.policies.inputs import Inputs
from rkhs_ros.policies.variance import ConstantVariance
from rkhs_ros.rkhs.pursuit import pursue

LEAST_SD = 1e-6  # of the exploration, where what was shown is fitted without error


@dataclass(frozen=True)
class Imitation(Settings):
    r"""Least squares of the actions shown, by few kernel functions of the states shown.

    .. math:: \min_h \frac1n \sum_t |a_t - h(s_t)|^2 + \lambda \|h\|^2

    with the centres of h chosen one after the other among the :math:`s_t` (Vincent and Bengio, 2002).
    """

    centres: int = setting(40, "number of centres of the policy at most", minimum=1, maximum=2000)
    ridge: float = setting(1e-6, "penalty lambda on the squared norm in the RKHS", minimum=0.0, maximum=1e6)
    inputs: Inputs = Inputs()
    kernel: KernelChoice = KernelChoice()

    def fit(self, episodes: Episodes) -> GaussianPolicy:
        """Return the policy, which explores as far as what was shown differs from its mean.

        Args:
            episodes: what was observed and done, at least one step in all.

        Raises:
            ValueError: there is no step, or the inputs do not fit.
        """
        require(bool(episodes.mask.any()), "episodes", "at least one step", "none")
        seen = episodes.seen_through(self.inputs)
        points, actions = seen.flat(seen.observations), seen.flat(seen.actions)
        kernel = self.kernel.fit(points, self.inputs.ages)
        mean = pursue(
            kernel, points, actions, points, budget=self.centres, ridge=self.ridge, rank=4 * self.centres
        ).function
        sd = np.sqrt(np.mean((actions - mean(points)) ** 2, axis=0))
        return GaussianPolicy(mean, ConstantVariance(np.maximum(sd, LEAST_SD) ** 2), self.inputs)


def imitation_from(tree: dict[str, object]) -> Imitation:
    """Return the settings of an imitation from a tree of values.

    Raises:
        ValueError: an unknown key or a value that does not fit.
    """
    return build(Imitation, tree)
