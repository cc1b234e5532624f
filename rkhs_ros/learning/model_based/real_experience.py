"""The real episodes of a run and its settings, as model-based training needs them."""

from dataclasses import dataclass

import numpy as np

from rkhs_ros.learning.episodes import Episodes
from rkhs_ros.learning.kernel_choice import KernelChoice
from rkhs_ros.policies.gaussian import GaussianPolicy
from rkhs_ros.policies.inputs import Inputs
from rkhs_ros.policies.spaces import Spaces
from rkhs_ros.rkhs.kernels import Array

TRIES = 3  # iterations after the first one before a run can be stuck
CLEAR_RISE = 0.05  # of a return above the first ones, relative to what the observed range of rewards leaves to gain


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
        earlier: policies before the newest one, which the model may now prefer to it.
        reward_depends_on_action_only: whether a cost of the actions explains the rewards of all steps.
        seeks_novelty: whether rollouts also reward the model's uncertainty, because new data have to show the way.
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
    earlier: tuple[GaussianPolicy, ...]
    reward_depends_on_action_only: bool
    seeks_novelty: bool
    given_inputs: Inputs

    @property
    def reward_width(self) -> float:
        """Width of the observed range of rewards, except terminal ones; 1 if all are equal."""
        width = float(np.ptp(_ordinary_rewards(self.episodes)))
        return width if width > 0.0 else 1.0


def is_stuck(episodes: Episodes, newest: int, discount: float) -> bool:
    """Return whether no return is clearly above those of the first, random episodes.

    The greatest return that the observed rewards suggest is that of the greatest one in every step. Terminal rewards do
    not count, since they come once.

    Args:
        episodes: all real episodes so far.
        newest: number of episodes of an iteration.
        discount: discount factor of the return.
    """
    first, later = np.split(episodes.returns(discount), [newest])
    if len(later) < TRIES * newest:
        return False
    steps = float(np.sum(discount ** np.arange(episodes.horizon)))
    to_gain = float(_ordinary_rewards(episodes).max()) * steps - first.mean()
    return bool(to_gain > 0.0 and later.max() - first.mean() < CLEAR_RISE * to_gain)


def _ordinary_rewards(episodes: Episodes) -> Array:
    """Return the rewards of the steps that did not terminate their episode, or of all steps if each did."""
    goes_on = episodes.mask & ~episodes.ends
    return episodes.rewards[goes_on if goes_on.any() else episodes.mask]
