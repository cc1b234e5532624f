r"""A model of a task, learnt from its episodes: how observations change, what is earned, and when an episode ends.

.. math:: o_{t+1} = o_t + f(x_t, a_t) + \epsilon, \qquad r_t = g(x_t, a_t) \text{ or } g(o_{t+1}, a_t), \qquad
    \text{over after } t \Leftrightarrow e(o_{t+1}) > 0

x are the policy's inputs, a is the action within its bounds, and + adds in the coordinates of
`rkhs_ros.learning.model.state_coordinates.StateCoordinates`. f, g and e are posteriors over functions, so the model
knows its own uncertainty (like PILCO's, Deisenroth and Rasmussen, 2011). Priors replace parts that need not be learnt.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from rkhs_ros.learning.episodes import Episodes
from rkhs_ros.learning.model.priors import Priors
from rkhs_ros.learning.model.state_coordinates import StateCoordinates
from rkhs_ros.policies.inputs import Inputs
from rkhs_ros.policies.spaces import Spaces
from rkhs_ros.rkhs.kernels import ROUNDING, Array, deviations, spreads
from rkhs_ros.rkhs.posterior import Posterior

NORMAL_MEDIAN = 0.4549  # of the square of a standard normal number
MOST_OVERCONFIDENCE = 3.0
MARGIN = 0.25  # of the range seen, that is imagined beyond it: a wall there would be leant on
EXPLAINED = 0.1  # part of the rewards' deviation that may be left
NO_PRIORS = Priors()


@dataclass(frozen=True)
class Transitions:
    """The steps of episodes as the model sees them, one row each.

    Attributes:
        points: inputs and action within its bounds, shape (n, p).
        actions: within their bounds, shape (n, m).
        observations: before the step, shape (n, d).
        next_observations: after it, shape (n, d).
        rewards: shape (n,).
        terminated: True where the task ended the episode then, shape (n,).
    """

    points: Array
    actions: Array
    observations: Array
    next_observations: Array
    rewards: Array
    terminated: np.ndarray

    @classmethod
    def of(cls, episodes: Episodes, inputs: Inputs, spaces: Spaces) -> Transitions:
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
class PredictionTest:
    """How a model predicted steps that it had not seen.

    Attributes:
        error: root mean square of the errors in the observations' changes, in standard deviations of these.
        overconfidence: how many times larger than expected the errors were, at least 1.
    """

    error: float
    overconfidence: float


@dataclass(frozen=True)
class DynamicsModel:
    """A model of a task.

    Attributes:
        inputs: what changes are functions of, beside the action.
        spaces: of the task.
        priors: what need not be learnt.
        motion: the coordinates of changes.
        state_delta: of the observation in a step, less those known.
        rewards: of a step after which the episode goes on; None where they are known.
        reward_depends_on_next: whether they follow from where a step leads, in place of where it begins.
        termination: above 0 if an observation ends the episode; None if a prior says so, or no episode was terminated.
        last_reward: what the last step of an episode that the task ends earns beside that, in the mean.
        low: least observation seen, shape (d,); -inf of what comes round.
        high: greatest observation seen, alike.
        reward_range: least and greatest reward seen.
        starts: first observations seen, shape (N, d).
        visited: all observations seen from which a step began, shape (n, d).
    """

    inputs: Inputs
    spaces: Spaces
    priors: Priors
    coordinates: StateCoordinates
    state_delta: Posterior
    rewards: Posterior | None
    reward_depends_on_next: bool
    termination: Posterior | None
    last_reward: float
    low: Array
    high: Array
    reward_range: tuple[float, float]
    starts: Array
    visited: Array

    @classmethod
    def fit(
        cls,
        episodes: Episodes,
        inputs: Inputs,
        spaces: Spaces,
        centres: int,
        known: Priors = NO_PRIORS,
    ) -> DynamicsModel:
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
        steps = Transitions.of(episodes, inputs, spaces)
        coordinates = _coordinates(steps, inputs)
        going_on = ~steps.terminated if not steps.terminated.all() else np.ones_like(steps.terminated)
        learnt = _rewards(steps, going_on, inputs, centres) if known.reward_fn is None else NO_REWARDS
        return cls(
            inputs=inputs,
            spaces=spaces,
            priors=known,
            coordinates=coordinates,
            state_delta=Posterior.fit(steps.points, _unknown_changes(steps, coordinates, known), centres),
            rewards=learnt.posterior,
            reward_depends_on_next=learnt.follow,
            termination=_ends(steps, inputs, centres) if known.termination_fn is None else None,
            last_reward=learnt.last,
            **_bounds(steps, coordinates),
            reward_range=(float(steps.rewards[going_on].min()), float(steps.rewards[going_on].max())),
            starts=episodes.observations[:, 0],
            visited=steps.observations,
        )

    def predict(self, observations: Array, actions: Array, changes: Array) -> Array:
        """Return observations, shape (rows, d), after unknown changes of that shape, not far beyond those seen.

        Args:
            observations: shape (rows, d).
            actions: within their bounds, shape (rows, m).
            changes: beside those known, shape (rows, d).
        """
        moved = self.coordinates.add(_as_known(self.priors, observations, actions), changes)
        return np.minimum(np.maximum(moved, self._lowest), self._highest)

    def clip_to_observed(self, observations: Array) -> Array:
        """Return observations, shape (..., d), or those within what was seen that are nearest to them."""
        return np.minimum(np.maximum(observations, self.low), self.high)

    @cached_property
    def _lowest(self) -> Array:
        return self.low - self._margin

    @cached_property
    def _highest(self) -> Array:
        return self.high + self._margin

    @property
    def _margin(self) -> Array:
        return np.where(np.isfinite(self.low), MARGIN * (self.high - self.low), 0.0)


def prediction_test(
    before: Episodes,
    after: Episodes,
    inputs: Inputs,
    spaces: Spaces,
    centres: int,
    known: Priors = NO_PRIORS,
) -> PredictionTest:
    """Return how a model of some episodes predicts the steps of others; the arguments are `DynamicsModel.fit`'s."""
    earlier, steps = (Transitions.of(episodes, inputs, spaces) for episodes in (before, after))
    coordinates = _coordinates(earlier, inputs)
    model = Posterior.fit(earlier.points, _unknown_changes(earlier, coordinates, known), centres)
    errors = coordinates.wrap(_unknown_changes(steps, coordinates, known) - model.mean(steps.points))
    expected = np.hypot(model.sd(steps.points), model.noise)
    expected = np.maximum(
        expected, ROUNDING * np.abs(steps.next_observations).max(axis=0)
    )  # as of a number that counts
    changes = coordinates.difference(steps.observations, steps.next_observations)
    moving = coordinates.columns
    sizes = np.sqrt(np.mean(errors**2, axis=0)) / deviations(changes)
    surprise = float(np.sqrt(np.mean(np.median((errors / expected)[:, moving] ** 2, axis=0) / NORMAL_MEDIAN)))
    error = float(np.sqrt(np.mean(sizes[moving] ** 2)))
    return PredictionTest(error, min(max(surprise, 1.0), MOST_OVERCONFIDENCE))


def reward_depends_on_action_only(episodes: Episodes, spaces: Spaces) -> bool:
    """Return whether a cost of the actions explains all that was earned, and the task ended no episode.

    Then no place is known to be better than another: where one is, if anywhere, none of the episodes has been.
    """
    if episodes.terminated.any():
        return False
    actions = spaces.clip(episodes.flat(episodes.actions)) / spaces.half_ranges
    costs = np.concatenate([np.ones((len(actions), 1)), actions, np.abs(actions), actions**2], axis=1)
    rewards = episodes.flat(episodes.rewards)
    unexplained = rewards - costs @ np.linalg.lstsq(costs, rewards, rcond=None)[0]
    return bool(unexplained.std() <= EXPLAINED * rewards.std() or spreads(rewards[:, None])[0] == 0)


def _coordinates(steps: Transitions, inputs: Inputs) -> StateCoordinates:
    return StateCoordinates.of(np.concatenate([steps.observations, steps.next_observations]), inputs.columns)


def _as_known(known: Priors, observations: Array, actions: Array) -> Array:
    """Return where observations lead as far as is known, shape (n, d): to themselves where nothing is."""
    return observations if known.dynamics_fn is None else observations + known.dynamics_fn(observations, actions)


def _unknown_changes(steps: Transitions, coordinates: StateCoordinates, known: Priors) -> Array:
    """Return the changes of the observations from where they lead as far as is known, shape (n, d)."""
    return coordinates.difference(_as_known(known, steps.observations, steps.actions), steps.next_observations)


class _Rewards(NamedTuple):
    """What is learnt of rewards, as `DynamicsModel` has it."""

    posterior: Posterior | None
    follow: bool
    last: float


NO_REWARDS = _Rewards(None, follow=False, last=0.0)


def _rewards(steps: Transitions, going_on: np.ndarray, inputs: Inputs, centres: int) -> _Rewards:
    """Return the rewards by where steps begin or by where they lead, whichever has the greater evidence."""
    leads = np.concatenate([inputs.features(steps.next_observations), steps.actions], axis=1)
    fits = [Posterior.fit(points[going_on], steps.rewards[going_on, None], centres) for points in (steps.points, leads)]
    follow = fits[1].evidence > fits[0].evidence
    best, points = (fits[1], leads) if follow else (fits[0], steps.points)
    last = 0.0
    if steps.terminated.any() and not steps.terminated.all():
        last = float((steps.rewards[steps.terminated] - best.mean(points[steps.terminated])[:, 0]).mean())
    return _Rewards(best, follow, last)


def _ends(steps: Transitions, inputs: Inputs, centres: int) -> Posterior | None:
    """Return the regression on +1 where the episode ended and -1 elsewhere.

    Ends are rare. Counted as they come, some would not be seen; with either side counting for half, the boundary would
    move inwards. The root of those weights lies between. Where every step ended its episode, it is +1 all over.
    """
    ended = steps.terminated
    if not ended.any():
        return None
    ends, goes_on = (max(int(which.sum()), 1) for which in (ended, ~ended))
    shares = np.sqrt(np.where(ended, 0.5 / ends, 0.5 / goes_on) * len(ended))
    points = inputs.features(steps.next_observations)
    return Posterior.fit(points, np.where(ended, 1.0, -1.0)[:, None], centres, shares)


def _bounds(steps: Transitions, coordinates: StateCoordinates) -> dict[str, Array]:
    """Return the range of the observations seen; what comes round has none."""
    seen = np.concatenate([steps.observations, steps.next_observations])
    low, high = seen.min(axis=0), seen.max(axis=0)
    low[coordinates.periodic], high[coordinates.periodic] = -np.inf, np.inf
    return {"low": low, "high": high}
