"""The real episodes of a run and its settings, as model-based training needs them."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from rkhs_ros.learning.episodes import Episodes
from rkhs_ros.learning.model.rewards import reward_depends_on_action_only
from rkhs_ros.learning.state import first_variance
from rkhs_ros.learning.training_settings import Training
from rkhs_ros.policies.gaussian import GaussianPolicy
from rkhs_ros.policies.spaces import Spaces
from rkhs_ros.rkhs.kernels import Array

TRIES = 3  # iterations after the first one before a run can be stuck
CLEAR_RISE = 0.05  # of a return above the first ones, relative to what the observed range of rewards leaves to gain


@dataclass(frozen=True)
class RealExperience:
    """The input of model-based training besides the policy.

    Attributes:
        training: settings of the run.
        spaces: spaces of the task.
        recorded: all real episodes so far, with raw observations.
        newest: number of episodes of the last iteration.
        action_repeat: number of steps for which the policy holds an action.
        iteration: number of previous real iterations.
        explorers: the last policies that explored, the newest first.
        best: the policy that was expected to be the best before the newest episodes; None without new episodes.
        may_explore: whether the trained policy runs new episodes, which may show the way to a run that is stuck.
    """

    training: Training
    spaces: Spaces
    recorded: Episodes
    newest: int
    action_repeat: int
    iteration: int
    explorers: tuple[GaussianPolicy, ...] = ()
    best: GaussianPolicy | None = None
    may_explore: bool = True

    @cached_property
    def episodes(self) -> Episodes:
        """The real episodes with one step per decision of the policy."""
        return self.recorded.decisions(self.action_repeat, self.training.discount, self.spaces)

    @property
    def discount(self) -> float:
        """Discount factor of the return, per decision."""
        return self.training.discount**self.action_repeat

    @property
    def first_variance(self) -> Array:
        """Variance of the first policy, shape (n,)."""
        return first_variance(self.training, self.spaces)

    @cached_property
    def reward_depends_on_action_only(self) -> bool:
        """Whether a cost of the actions explains the rewards of all steps."""
        return reward_depends_on_action_only(self.recorded, self.spaces)

    @property
    def seeks_novelty(self) -> bool:
        """Whether rollouts also reward the model's uncertainty, because new data have to show the way."""
        stuck = self.reward_depends_on_action_only or is_stuck(self.recorded, self.newest, self.training.discount)
        return self.may_explore and stuck

    @property
    def reward_width(self) -> float:
        """Width of the observed range of rewards, except terminal ones; 1 if all are equal."""
        width = float(np.ptp(_ordinary_rewards(self.episodes)))
        return width if width > 0.0 else 1.0


def is_stuck(episodes: Episodes, newest: int, discount: float) -> bool:
    """Return whether no return is clearly above those of the first, random episodes.

    The greatest return that the observed rewards suggest is that of the greatest one in every step. Terminal rewards do
    not count, since they come once. An iteration has ``newest`` of the episodes.
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
