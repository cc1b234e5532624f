r"""A model of a task, learnt from its episodes: how observations change, what is earned, and when an episode ends.

.. math:: o_{t+1} = o_t + f(x_t, a_t) + \epsilon, \qquad r_t = g(x_t, a_t), \qquad
    \text{over after } t \Leftrightarrow e(o_{t+1}) > 0

x is what the policy is given of the history, a the action within its bounds. f, g and e are posteriors over
functions, so that the model knows what it does not know (as PILCO's, Deisenroth and Rasmussen, 2011). Parts that are
known need not be learnt.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rkhs_ros.learning.episodes import Episodes
from rkhs_ros.learning.known_parts import KnownParts
from rkhs_ros.policies.inputs import Inputs
from rkhs_ros.policies.spaces import Spaces
from rkhs_ros.rkhs.kernels import ROUNDING, Array, deviations
from rkhs_ros.rkhs.posterior import Posterior

NORMAL_MEDIAN = 0.4549  # of the square of a standard normal number
MOST_OVERCONFIDENCE = 3.0
NOTHING_KNOWN = KnownParts()


@dataclass(frozen=True)
class Steps:
    """The steps of episodes as the model sees them, one row each.

    Attributes:
        points: inputs and action within its bounds, shape (n, p).
        actions: within their bounds, shape (n, m).
        observations: before the step, shape (n, d).
        following: after it, shape (n, d).
        rewards: shape (n,).
        ended: True where the task ended the episode then, shape (n,).
    """

    points: Array
    actions: Array
    observations: Array
    following: Array
    rewards: Array
    ended: np.ndarray

    @classmethod
    def of(cls, episodes: Episodes, inputs: Inputs, spaces: Spaces) -> Steps:
        """Return the steps of episodes, whose observations are as they were seen."""
        last = episodes.mask.sum(axis=1) - 1
        rows = np.arange(len(episodes))
        following = np.roll(episodes.observations, -1, axis=1)
        following[rows, last] = episodes.final_observations
        ended = np.zeros(episodes.mask.shape, dtype=bool)
        ended[rows, last] = episodes.terminated
        points = points_of(inputs.unfold(episodes.observations, episodes.actions), episodes.actions, spaces)
        actions = points[..., -spaces.action_dim :]
        every = (points, actions, episodes.observations, following, episodes.rewards, ended)
        return cls(*(episodes.flat(values) for values in every))


def points_of(inputs: Array, actions: Array, spaces: Spaces) -> Array:
    """Return inputs, shape (..., q), beside actions within their bounds, shape (..., n)."""
    clipped = spaces.clip(actions.reshape(-1, actions.shape[-1])).reshape(actions.shape)
    return np.concatenate([inputs, clipped], axis=-1)


@dataclass(frozen=True)
class ModelTest:
    """How a model predicted steps that it had not seen.

    Attributes:
        error: root mean square of the errors in the observations' changes, in standard deviations of these.
        overconfidence: how many times larger than expected the errors were, at least 1.
    """

    error: float
    overconfidence: float


@dataclass(frozen=True)
class WorldModel:
    """A model of a task.

    Attributes:
        inputs: what changes and rewards are functions of, beside the action.
        spaces: of the task.
        known: what need not be learnt.
        changes: of the observation in a step, less those known; of an angle the short way round.
        rewards: of a step after which the episode goes on; None where they are known.
        ends: above 0 where an observation ends the episode; None where that is known, or the task ended no episode.
        last_reward: what the last step of an episode that the task ends earns beside that, in the mean.
        low: least observation that is imagined, shape (d,).
        high: greatest observation that is imagined, shape (d,).
        reward_range: least and greatest reward seen.
        starts: first observations seen, shape (N, d).
    """

    inputs: Inputs
    spaces: Spaces
    known: KnownParts
    changes: Posterior
    rewards: Posterior | None
    ends: Posterior | None
    last_reward: float
    low: Array
    high: Array
    reward_range: tuple[float, float]
    starts: Array

    @classmethod
    def fit(
        cls,
        episodes: Episodes,
        inputs: Inputs,
        spaces: Spaces,
        centres: int,
        known: KnownParts = NOTHING_KNOWN,
    ) -> WorldModel:
        """Return the model of a task of which episodes were seen.

        Args:
            episodes: N at least 1, their observations as they were seen.
            inputs: of the policy.
            spaces: of the task.
            centres: kernel functions of each posterior at most.
            known: what need not be learnt.

        Raises:
            RunError: a function of what is known failed.
        """
        steps = Steps.of(episodes, inputs, spaces)
        going_on = ~steps.ended if not steps.ended.all() else np.ones_like(steps.ended)
        rewards = None
        if known.reward is None:
            rewards = Posterior.fit(steps.points[going_on], steps.rewards[going_on, None], centres)
        return cls(
            inputs=inputs,
            spaces=spaces,
            known=known,
            changes=Posterior.fit(steps.points, _unknown_changes(steps, inputs, known), centres),
            rewards=rewards,
            ends=_ends(steps, inputs, centres) if known.end is None else None,
            last_reward=0.0 if rewards is None else _last_reward(steps, rewards),
            **_bounds(steps, inputs),
            reward_range=(float(steps.rewards[going_on].min()), float(steps.rewards[going_on].max())),
            starts=episodes.observations[:, 0],
        )

    def following(self, observations: Array, actions: Array, changes: Array) -> Array:
        """Return observations, shape (rows, d), after unknown changes of that shape, within what can be imagined.

        Args:
            observations: shape (rows, d).
            actions: within their bounds, shape (rows, m).
            changes: beside those known, shape (rows, d).
        """
        if self.known.change is not None:
            changes = changes + self.known.change(observations, actions)
        moved = turn(observations + changes, self.inputs)
        return np.minimum(np.maximum(moved, self.low), self.high)


def prediction_test(
    before: Episodes,
    after: Episodes,
    inputs: Inputs,
    spaces: Spaces,
    centres: int,
    known: KnownParts = NOTHING_KNOWN,
) -> ModelTest:
    """Return how a model of some episodes predicts the steps of others; the arguments are `WorldModel.fit`'s."""
    earlier, steps = (Steps.of(episodes, inputs, spaces) for episodes in (before, after))
    model = Posterior.fit(earlier.points, _unknown_changes(earlier, inputs, known), centres)
    errors = turn(_unknown_changes(steps, inputs, known) - model.mean(steps.points), inputs)
    expected = np.hypot(model.sd(steps.points), model.noise)
    expected = np.maximum(expected, ROUNDING * np.abs(steps.following).max(axis=0))  # as of a number that counts
    sizes = np.sqrt(np.mean(errors**2, axis=0)) / deviations(_unknown_changes(steps, inputs, NOTHING_KNOWN))
    surprise = float(np.sqrt(np.mean(np.median((errors / expected) ** 2, axis=0) / NORMAL_MEDIAN)))
    return ModelTest(float(np.sqrt(np.mean(sizes**2))), min(max(surprise, 1.0), MOST_OVERCONFIDENCE))


def _unknown_changes(steps: Steps, inputs: Inputs, known: KnownParts) -> Array:
    """Return the changes of the observations less those known, shape (n, d)."""
    changes = steps.following - steps.observations
    if known.change is not None:
        changes = changes - known.change(steps.observations, steps.actions)
    return turn(changes, inputs)


def turn(values: Array, inputs: Inputs) -> Array:
    """Return values, shape (rows, d), with the angles among them turned into [-pi, pi)."""
    if not inputs.columns:
        return values
    turned = values.copy()
    turned[:, inputs.columns] = np.remainder(values[:, inputs.columns] + np.pi, 2.0 * np.pi) - np.pi
    return turned


def _ends(steps: Steps, inputs: Inputs, centres: int) -> Posterior | None:
    """Return the regression on +1 where the episode ended and -1 elsewhere.

    Ends are rare. Counted as they come, some would not be seen; with either side counting for half, the boundary would
    move inwards. The root of those weights lies between. Where every step ended its episode, it is +1 all over.
    """
    ended = steps.ended
    if not ended.any():
        return None
    ends, goes_on = (max(int(which.sum()), 1) for which in (ended, ~ended))
    shares = np.sqrt(np.where(ended, 0.5 / ends, 0.5 / goes_on) * len(ended))
    points = inputs.features(steps.following)
    return Posterior.fit(points, np.where(ended, 1.0, -1.0)[:, None], centres, shares)


def _last_reward(steps: Steps, rewards: Posterior) -> float:
    if not steps.ended.any() or steps.ended.all():
        return 0.0
    return float((steps.rewards[steps.ended] - rewards.mean(steps.points[steps.ended])[:, 0]).mean())


def _bounds(steps: Steps, inputs: Inputs) -> dict[str, Array]:
    """Return the range of the observations seen; angles have none. What was never seen is not to be exploited."""
    seen = np.concatenate([steps.observations, steps.following])
    low, high = seen.min(axis=0), seen.max(axis=0)
    low[inputs.columns], high[inputs.columns] = -np.inf, np.inf
    return {"low": low, "high": high}
