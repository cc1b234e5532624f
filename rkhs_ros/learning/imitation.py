"""Imitation: fit a policy to demonstrations by kernel matching pursuit, as a warm start for any algorithm."""

from dataclasses import dataclass, replace

import numpy as np

from rkhs_ros.base.settings import Settings, setting
from rkhs_ros.base.validation import require
from rkhs_ros.learning.episodes import Episodes
from rkhs_ros.learning.kernel_choice import KernelChoice
from rkhs_ros.policies.gaussian import MOST_REPEAT, GaussianPolicy
from rkhs_ros.policies.inputs import Inputs
from rkhs_ros.policies.spaces import Spaces
from rkhs_ros.policies.variance import ConstantVariance
from rkhs_ros.rkhs.pursuit import pursue

UNDISCOUNTED = 1.0  # any discount will do, since imitation ignores rewards
LEAST_SD = 1e-6  # minimum exploration, for demonstrations that are fitted without error


@dataclass(frozen=True)
class Imitation(Settings):
    r"""Settings of imitation: least squares of the demonstrated actions with few kernel functions.

    .. math:: \min_h \frac1n \sum_t |a_t - b - h(s_t)|^2 + \lambda \|h\|^2

    b is the middle of the actions' bounds. The centres of h are selected greedily among the demonstrated states
    :math:`s_t` (Vincent and Bengio, 2002).
    """

    centres: int = setting(40, "maximum number of centres of the policy", minimum=1, maximum=2000)
    ridge: float = setting(1e-6, "penalty lambda on the squared norm in the RKHS", minimum=0.0, maximum=1e6)
    action_repeat: int = setting(
        1, "number of steps for which the policy holds an action", minimum=1, maximum=MOST_REPEAT
    )
    inputs: Inputs = Inputs()
    kernel: KernelChoice = KernelChoice()

    def fit(self, episodes: Episodes, spaces: Spaces) -> GaussianPolicy:
        """Fit a policy whose exploration is the error of the fit.

        Args:
            episodes: demonstrated observations and actions, at least one step in total. The fit uses the steps at which
                the policy decides.
            spaces: spaces of the task.

        Raises:
            ValueError: there is no step, or the inputs do not match the observations.
        """
        require(bool(episodes.mask.any()), "episodes", "at least one step", "none")
        inputs = self.kernel.inputs_of(self.inputs).within(spaces)
        demonstrated = episodes.decisions(self.action_repeat, UNDISCOUNTED, spaces).with_inputs(inputs)
        points, actions = demonstrated.flat(demonstrated.observations), demonstrated.flat(demonstrated.actions)
        kernel = self.kernel.fit(points, inputs.ages)
        targets = actions - np.array(spaces.middle or 0.0)
        fit = pursue(kernel, points, targets, points, budget=self.centres, ridge=self.ridge).function
        mean = replace(fit, bias=spaces.middle)
        sd = np.sqrt(np.mean((actions - mean(points)) ** 2, axis=0))
        variance = ConstantVariance(np.maximum(sd, LEAST_SD) ** 2)
        return GaussianPolicy(mean, variance, inputs, action_repeat=self.action_repeat)
