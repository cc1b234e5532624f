r"""The rewards of a model: a cost of the actions c, and a function g of the current or the next observation.

.. math:: r_t = c(a_t) + g(x_t, a_t) \text{ or } c(a_t) + g(o_{t+1}, a_t), \qquad
    c(a) = w_0 + \sum_j w_{1j} a_j + w_{2j} |a_j| + w_{3j} a_j^2

Costs that explain most of the rewards hide the differences between states that policies have to find. So c is fitted
first, by least squares, and g is the posterior of the rest. Otherwise, c is 0.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rkhs_ros.learning.episodes import Episodes
from rkhs_ros.learning.model.termination import TerminalReward
from rkhs_ros.learning.model.transitions import Transitions
from rkhs_ros.policies.inputs import Inputs
from rkhs_ros.policies.spaces import Spaces
from rkhs_ros.rkhs.evidence import BANDWIDTHS, FINE_BANDWIDTHS, Hyperprior
from rkhs_ros.rkhs.kernels import Array, spreads
from rkhs_ros.rkhs.posterior import Posterior

MOSTLY = 0.7  # part of the rewards' standard deviation that a cost of the actions may leave unexplained to be used
ALMOST = 0.01  # the same if states are to make no difference
FEWEST_PER_COST = 2  # steps per coefficient of a cost that is fitted to them
PEAKS = Hyperprior(FINE_BANDWIDTHS, FINE_BANDWIDTHS)  # the goal alone earns more
# A distance has a kink. Narrow kernels follow it, so they find out what the distance is of. Wide ones in this metric
# know more between the steps, unless their size is free: huge ones follow the kink, too, and are wrong beside the data.
KINKS = Hyperprior(BANDWIDTHS, FINE_BANDWIDTHS, bounded=True)


@dataclass(frozen=True)
class ActionCost:
    """A cost of the actions, with square, absolute and linear terms.

    Attributes:
        units: half the range of each action, shape (n,).
        weights: coefficients of 1, the actions, their sizes and their squares, shape (1 + 3 n,).
    """

    units: Array
    weights: Array

    @classmethod
    def fit(cls, actions: Array, rewards: Array, spaces: Spaces, unexplained: float) -> ActionCost | None:
        """Fit the cost to steps.

        Args:
            actions: clipped actions, shape (n, m).
            rewards: shape (n,).
            spaces: spaces of the task.
            unexplained: greatest part of the rewards' standard deviation that may remain. If more does, if there are
                too few steps to tell, or if all rewards are equal, the result is None.
        """
        units = spaces.half_ranges
        terms = cls._terms(actions / units)
        if len(terms) < FEWEST_PER_COST * terms.shape[1] or spreads(rewards[:, None])[0] == 0:
            return None
        weights = np.linalg.lstsq(terms, rewards, rcond=None)[0].astype(np.float64)
        rest = rewards - terms @ weights
        deviation = np.sqrt(rest @ rest / (len(terms) - terms.shape[1]))  # of few steps, some is explained by chance
        return cls(units, weights) if deviation <= unexplained * rewards.std() else None

    def __call__(self, actions: Array) -> Array:
        """Return the (negative) rewards of clipped actions, shape (..., m): shape (...)."""
        return self._terms(actions / self.units) @ self.weights

    @staticmethod
    def _terms(actions: Array) -> Array:
        return np.concatenate([np.ones((*actions.shape[:-1], 1)), actions, np.abs(actions), actions**2], axis=-1)


@dataclass(frozen=True)
class Rewards:
    """The learnt rewards.

    Attributes:
        cost: cost of the actions; None if it does not explain most of the rewards.
        posterior: posterior of the other reward of a non-terminal step.
        limits: smallest and largest observed other reward of non-terminal steps.
        depends_on_next: whether it is a function of the next observation instead of the current one.
        are_rare: whether most steps earn the same reward, and the others, if any, more.
        terminal: reward that a terminal step earns in addition.
    """

    cost: ActionCost | None
    posterior: Posterior
    limits: tuple[float, float]
    depends_on_next: bool
    are_rare: bool
    terminal: TerminalReward

    @classmethod
    def fit(cls, steps: Transitions, inputs: Inputs, spaces: Spaces, centres: int) -> Rewards:
        """Fit rewards as functions of the current or the next observation, whichever has the greater evidence."""
        goes_on = steps.goes_on
        leads = np.concatenate([inputs.features(steps.next_observations), steps.actions], axis=1)
        earned = steps.rewards[goes_on]
        are_rare = bool(np.median(earned) == earned.min())
        cost = ActionCost.fit(steps.actions[goes_on], earned, spaces, MOSTLY)
        others = steps.rewards if cost is None else steps.rewards - cost(steps.actions)
        targets = others[goes_on, None]
        hyperprior = PEAKS if are_rare else KINKS
        fits = [Posterior.fit(p[goes_on], targets, centres, hyperprior=hyperprior) for p in (steps.points, leads)]
        depends_on_next = fits[1].evidence > fits[0].evidence
        best, points = (fits[1], leads) if depends_on_next else (fits[0], steps.points)
        ended, terminal = steps.terminated, TerminalReward()
        if ended.any() and not ended.all():
            extra = others[ended] - best.mean(points[ended])[:, 0]
            terminal = TerminalReward.fit(leads[ended], extra, steps.rewards[ended], float(np.ptp(targets)), centres)
        limits = float(targets.min()), float(targets.max())
        return cls(cost, best, limits, depends_on_next, are_rare, terminal)

    def of(self, others: Array, actions: Array, margin: float) -> Array:
        """Return the rewards of steps, shape (...).

        Args:
            others: rewards without the cost of the actions, shape (...).
            actions: clipped actions, shape (..., m).
            margin: by which the others may lie outside their limits, relative to the distance of these.
        """
        least, greatest = self.limits
        # Widen both ends: clipping noisy rewards at one end only would bias their mean where the model is uncertain.
        beyond = margin * (greatest - least)
        clipped = np.clip(others, least - beyond, greatest + beyond)
        return clipped if self.cost is None else clipped + self.cost(actions)


def reward_depends_on_action_only(episodes: Episodes, spaces: Spaces) -> bool:
    """Return whether a cost of the actions explains all rewards, and the task terminated no episode.

    If so, no visited state is known to be better than another, and exploration has to reach further. Few steps show
    this only if all rewards are equal, because a cost of the actions can explain any rewards of few steps.
    """
    if episodes.terminated.any():
        return False
    actions, rewards = spaces.clip(episodes.flat(episodes.actions)), episodes.flat(episodes.rewards)
    return spreads(rewards[:, None])[0] == 0 or ActionCost.fit(actions, rewards, spaces, ALMOST) is not None
