r"""A dynamics model that is learnt from episodes: changes of observations, rewards and termination.

.. math:: o_{t+1} = o_t + f(x_t, a_t) + \epsilon, \qquad r_t = g(x_t, a_t) \text{ or } g(o_{t+1}, a_t), \qquad
    \text{over after } t \Leftrightarrow o_{t+1} \in E

x are the policy's inputs, a is the clipped action, and + adds in the coordinates of
`rkhs_ros.learning.model.state_coordinates.StateCoordinates`. f and g are posteriors over functions and E
is a random set, so the model represents its own uncertainty (like PILCO's, Deisenroth and Rasmussen, 2011). Priors
replace parts of the model.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from rkhs_ros.learning.episodes import Episodes
from rkhs_ros.learning.model.priors import Priors
from rkhs_ros.learning.model.state_coordinates import StateCoordinates
from rkhs_ros.learning.model.termination import Limits, TerminalReward, fit_termination
from rkhs_ros.policies.inputs import Inputs
from rkhs_ros.policies.spaces import Spaces
from rkhs_ros.rkhs.evidence import BANDWIDTHS, FINE_BANDWIDTHS
from rkhs_ros.rkhs.kernels import Array, deviations, spreads
from rkhs_ros.rkhs.posterior import Posterior

MARGIN = 0.25  # part of the observed range that rollouts may exceed it by: policies learn to exploit hard clipping
EXPLAINED = 0.1  # part of the rewards' standard deviation that may remain unexplained
BEYOND = 0.5  # of the distance of two recorded initial observations, how far others may lie beyond them
VARYING = 0.1  # spread of the initial observations above which they vary, relative to that of the visited ones
FEWEST_PER_COST = 2  # steps per coefficient of a cost that is fitted to them
MOST_TRANSITIONS = 20_000  # more make a fit slower but hardly better
NO_PRIORS = Priors()


@dataclass(frozen=True)
class Transitions:
    """The transitions of episodes, one row each.

    Attributes:
        points: policy inputs and clipped action, shape (n, p).
        actions: clipped actions, shape (n, m).
        observations: observations before the step, shape (n, d).
        next_observations: observations after the step, shape (n, d).
        rewards: shape (n,).
        terminated: whether the task terminated the episode after the step, shape (n,).
    """

    points: Array
    actions: Array
    observations: Array
    next_observations: Array
    rewards: Array
    terminated: np.ndarray

    @classmethod
    def of(cls, episodes: Episodes, inputs: Inputs, spaces: Spaces) -> Transitions:
        """Return the transitions of episodes with raw observations."""
        points = points_of(inputs.unfold(episodes.observations, episodes.actions), episodes.actions, spaces)
        moves = points, points[..., -spaces.action_dim :], episodes.observations, episodes.next_observations
        every: tuple[NDArray[Any], ...] = (*moves, episodes.rewards, episodes.ends)
        return cls(*(episodes.flat(values) for values in every))

    def last(self, count: int) -> Transitions:
        """Return the last ``count`` transitions, or all if there are fewer."""
        return self._at(slice(-count, None))

    def thinned(self, most: int) -> Transitions:
        """Return evenly spaced transitions, about ``most`` of them, and all that terminate an episode."""
        stride = -(-len(self.points) // most)
        if stride == 1:
            return self
        return self._at(np.flatnonzero((np.arange(len(self.points)) % stride == 0) | self.terminated))

    def _at(self, rows: slice | NDArray[np.int_]) -> Transitions:
        return Transitions(*(getattr(self, f.name)[rows] for f in fields(self)))


def points_of(inputs: Array, actions: Array, spaces: Spaces) -> Array:
    """Concatenate inputs, shape (..., q), and clipped actions, shape (..., n)."""
    clipped = spaces.clip(actions.reshape(-1, actions.shape[-1])).reshape(actions.shape)
    return np.concatenate([inputs, clipped], axis=-1)


@dataclass(frozen=True)
class DynamicsModel:
    """A probabilistic model of a task.

    Attributes:
        inputs: computes the model's inputs, besides the action, from the observations.
        spaces: spaces of the task.
        priors: functions that replace learnt parts.
        coordinates: coordinates of changes.
        state_delta: posterior of the change of the observation in a step, without the prior part.
        rewards: posterior of the reward of a non-terminal step; None with a prior.
        reward_depends_on_next: whether the reward is a function of the next observation instead of the current one.
        rewards_are_rare: whether most steps earn the same reward, and the others, if any, more; False with a prior.
        termination: limits of the features beyond which an episode is terminated, or a posterior that is positive
            there; None with a prior, or if no episode was terminated.
        terminal_reward: reward that a terminal step earns in addition to the prediction of the attribute ``rewards``.
        low: lower end of the observed range, shape (d,); -inf for periodic columns.
        high: upper end of the observed range, shape (d,); inf for periodic columns.
        reward_range: smallest and largest observed reward of non-terminal steps.
        starts: observed initial observations, shape (N, d).
        starts_vary: whether initial observations may differ by more than a tenth of the spread of all observations.
        visited: observed observations before each step, shape (n, d).
    """

    inputs: Inputs
    spaces: Spaces
    priors: Priors
    coordinates: StateCoordinates
    state_delta: Posterior
    rewards: Posterior | None
    reward_depends_on_next: bool
    rewards_are_rare: bool
    termination: Limits | Posterior | None
    terminal_reward: TerminalReward
    low: Array
    high: Array
    reward_range: tuple[float, float]
    starts: Array
    starts_vary: bool
    visited: Array

    @classmethod
    def fit(
        cls,
        episodes: Episodes,
        inputs: Inputs,
        spaces: Spaces,
        centres: int,
        priors: Priors = NO_PRIORS,
        *,
        centred: bool = False,
    ) -> DynamicsModel:
        """Fit a Gaussian-process dynamics model to episodes.

        Args:
            episodes: at least one episode, with raw observations.
            inputs: inputs of the policy.
            spaces: spaces of the task.
            centres: maximum number of centres of each posterior.
            priors: functions that replace learnt parts.
            centred: also try the centred metric for the changes; see `rkhs_ros.rkhs.metric_learning`.

        Raises:
            RunError: a prior function failed.
        """
        steps = Transitions.of(episodes, inputs, spaces).thinned(MOST_TRANSITIONS)
        coordinates = coordinates_of(steps, inputs)
        going_on = ~steps.terminated if not steps.terminated.all() else np.ones_like(steps.terminated)
        changes = _residual_changes(steps, coordinates, priors)
        learnt = _rewards(steps, going_on, inputs, centres) if priors.reward_fn is None else NO_REWARDS
        return cls(
            inputs=inputs,
            spaces=spaces,
            priors=priors,
            coordinates=coordinates,
            state_delta=Posterior.fit(steps.points, changes, centres, centred=centred),
            rewards=learnt.posterior,
            reward_depends_on_next=learnt.depends_on_next,
            rewards_are_rare=learnt.are_rare,
            termination=_termination(steps, inputs, centres) if priors.termination_fn is None else None,
            terminal_reward=learnt.terminal,
            **_bounds(steps, coordinates),
            reward_range=(float(steps.rewards[going_on].min()), float(steps.rewards[going_on].max())),
            starts=episodes.observations[:, 0],
            starts_vary=_starts_vary(episodes.observations[:, 0], steps, inputs),
            visited=steps.observations,
        )

    def predict(self, observations: Array, actions: Array, changes: Array) -> Array:
        """Return the next observations, shape (n, d), clipped to the observed range plus a margin.

        Args:
            observations: current observations, shape (n, d).
            actions: clipped actions, shape (n, m).
            changes: changes of the observations without the prior part, shape (n, d).
        """
        return self.possible(self.coordinates.add(_apply_prior(self.priors, observations, actions), changes))

    def draw_start(self, random: np.random.Generator) -> Array:
        """Draw an initial observation, shape (d,); if they vary, on the line through two recorded ones."""
        one, other = self.starts[random.integers(len(self.starts), size=(2, 1))]
        if not self.starts_vary:
            return np.asarray(one[0])
        way = random.uniform(-BEYOND, 1.0 + BEYOND) * self.coordinates.difference(one, other)
        return np.asarray(self.possible(self.coordinates.add(one, way))[0])

    def possible(self, observations: Array) -> Array:
        """Return observations, shape (n, d), clipped to the observed range plus a margin."""
        return np.minimum(np.maximum(observations, self._lowest), self._highest)

    def at_limits(self, observations: Array) -> NDArray[np.bool_]:
        """Return which numbers of observations, shape (..., d), lie at the limits of `possible`: shape (..., d)."""
        return np.asarray((observations <= self._lowest) | (observations >= self._highest))

    def clip_to_observed(self, observations: Array) -> Array:
        """Return observations, shape (..., d), clipped to the observed range."""
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


def prediction_error(
    before: Episodes,
    after: Episodes,
    inputs: Inputs,
    spaces: Spaces,
    centres: int,
    priors: Priors = NO_PRIORS,
    *,
    centred: bool = False,
) -> float:
    """Fit a model to some episodes, and test it on others; see `DynamicsModel.fit` for the arguments.

    Returns:
        The root mean square error of the predicted changes, in standard deviations of the changes.
    """
    earlier, steps = (
        Transitions.of(episodes, inputs, spaces).thinned(MOST_TRANSITIONS) for episodes in (before, after)
    )
    coordinates = coordinates_of(earlier, inputs)
    changes = _residual_changes(earlier, coordinates, priors)
    model = Posterior.fit(earlier.points, changes, centres, centred=centred)
    errors = coordinates.wrap(_residual_changes(steps, coordinates, priors) - model.mean(steps.points))
    changes = coordinates.difference(steps.observations, steps.next_observations)
    sizes = np.sqrt(np.mean(errors**2, axis=0)) / deviations(changes)
    return float(np.sqrt(np.mean(sizes[coordinates.columns] ** 2)))


def reward_depends_on_action_only(episodes: Episodes, spaces: Spaces) -> bool:
    """Return whether a cost of the actions explains all rewards, and the task terminated no episode.

    If so, no visited state is known to be better than another, and exploration has to reach further. Few steps show
    this only if all rewards are equal, because a cost of the actions can explain any rewards of few steps.
    """
    if episodes.terminated.any():
        return False
    actions = spaces.clip(episodes.flat(episodes.actions)) / spaces.half_ranges
    costs = np.concatenate([np.ones((len(actions), 1)), actions, np.abs(actions), actions**2], axis=1)
    rewards = episodes.flat(episodes.rewards)
    if spreads(rewards[:, None])[0] == 0:
        return True
    if len(costs) < FEWEST_PER_COST * costs.shape[1]:
        return False
    unexplained = rewards - costs @ np.linalg.lstsq(costs, rewards, rcond=None)[0]
    return bool(unexplained.std() <= EXPLAINED * rewards.std())


def coordinates_of(steps: Transitions, inputs: Inputs) -> StateCoordinates:
    """Return the coordinates in which the observations of steps change."""
    return StateCoordinates.of(np.concatenate([steps.observations, steps.next_observations]), inputs)


def _apply_prior(priors: Priors, observations: Array, actions: Array) -> Array:
    """Return the next observations that the prior dynamics predict, shape (n, d); without a prior, no change."""
    return observations if priors.dynamics_fn is None else observations + priors.dynamics_fn(observations, actions)


def _residual_changes(steps: Transitions, coordinates: StateCoordinates, priors: Priors) -> Array:
    """Return the changes of the observations without the prior part, shape (n, d)."""
    return coordinates.difference(_apply_prior(priors, steps.observations, steps.actions), steps.next_observations)


class _Rewards(NamedTuple):
    """The learnt rewards, with the meaning of `DynamicsModel`'s attributes."""

    posterior: Posterior | None
    depends_on_next: bool
    are_rare: bool
    terminal: TerminalReward


NO_REWARDS = _Rewards(None, depends_on_next=False, are_rare=False, terminal=TerminalReward())


def _rewards(steps: Transitions, going_on: np.ndarray, inputs: Inputs, centres: int) -> _Rewards:
    """Fit the rewards as a function of the current or the next observation, whichever has the greater evidence."""
    leads = np.concatenate([inputs.features(steps.next_observations), steps.actions], axis=1)
    earned = steps.rewards[going_on, None]
    are_rare = bool(np.median(earned) == earned.min())
    bandwidths = FINE_BANDWIDTHS if are_rare else BANDWIDTHS  # the goal alone earns more
    fits = [Posterior.fit(p[going_on], earned, centres, bandwidths=bandwidths) for p in (steps.points, leads)]
    depends_on_next = fits[1].evidence > fits[0].evidence
    best, points = (fits[1], leads) if depends_on_next else (fits[0], steps.points)
    ended, terminal = steps.terminated, TerminalReward()
    if ended.any() and not ended.all():
        rewards = steps.rewards[ended]
        extra = rewards - best.mean(points[ended])[:, 0]
        terminal = TerminalReward.fit(leads[ended], extra, rewards, float(np.ptp(steps.rewards[~ended])), centres)
    return _Rewards(best, depends_on_next, are_rare, terminal)


def _starts_vary(starts: Array, steps: Transitions, inputs: Inputs) -> bool:
    """Return whether the features of initial observations vary; a single one does not show it.

    Columns that change in one step by more than their spread are noise and have no effect.
    """
    if len(starts) == 1:
        return True
    initial, before, after = (inputs.features(each) for each in (starts, steps.observations, steps.next_observations))
    spread = before.std(axis=0)
    is_state = (after - before).std(axis=0) < spread
    return bool((initial.std(axis=0) > VARYING * spread)[is_state].any())


def _termination(steps: Transitions, inputs: Inputs, centres: int) -> Limits | Posterior | None:
    before, after = inputs.features(steps.observations), inputs.features(steps.next_observations)
    return fit_termination(before, after, steps.terminated, centres)


def _bounds(steps: Transitions, coordinates: StateCoordinates) -> dict[str, Array]:
    """Return the range of the observations, infinite for periodic columns."""
    observed = np.concatenate([steps.observations, steps.next_observations])
    low, high = observed.min(axis=0), observed.max(axis=0)
    low[coordinates.periodic], high[coordinates.periodic] = -np.inf, np.inf
    return {"low": low, "high": high}
