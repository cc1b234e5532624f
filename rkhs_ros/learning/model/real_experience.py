"""The real episodes of a run and its settings, as model-based training needs them."""

from __future__ import annotations

from dataclasses import dataclass

from rkhs_ros.learning.episodes import Episodes
from rkhs_ros.learning.kernel_choice import KernelChoice
from rkhs_ros.policies.inputs import Inputs
from rkhs_ros.policies.spaces import Spaces
from rkhs_ros.rkhs.kernels import Array


@dataclass(frozen=True)
class RealExperience:
    """The input of model-based training besides its settings and the policy.

    Attributes:
        episodes: all real episodes so far, with raw observations and one step per decision of the policy.
        newest: number of episodes of the last iteration.
        discount: discount factor of the return, per decision.
        spaces: spaces of the task.
        kernel: settings of the policy's kernel.
        first_variance: variance of the first policy, shape (n,).
        seed: seed of the run.
        iteration: number of previous real iterations.
        reward_depends_on_action_only: whether a cost of the actions explains the rewards of all steps.
        outperformed_iterations: number of previous iterations with a lower return than the newest one.
        given_inputs: inputs in the settings of the run, before anything was found in its data.
    """

    episodes: Episodes
    newest: int
    discount: float
    spaces: Spaces
    kernel: KernelChoice
    first_variance: Array
    seed: int
    iteration: int
    reward_depends_on_action_only: bool
    outperformed_iterations: float
    given_inputs: Inputs
