r"""A dynamics model that is learnt from episodes: changes of observations, rewards and termination.

.. math:: o_{t+1} = o_t + f(x_t, a_t) + \epsilon, \qquad \text{over after } t \Leftrightarrow o_{t+1} \in E

x are the policy's inputs, a is the clipped action, and + adds in the coordinates of
`rkhs_ros.learning.model.state_coordinates.StateCoordinates`. f is a posterior over functions and E is a random set, so
the model represents its own uncertainty (like PILCO's, Deisenroth and Rasmussen, 2011). The rewards are in
`rkhs_ros.learning.model.rewards`. Priors replace parts of the model.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rkhs_ros.learning.episodes import Episodes
from rkhs_ros.learning.model.priors import Priors
from rkhs_ros.learning.model.rewards import Rewards
from rkhs_ros.learning.model.state_coordinates import StateCoordinates
from rkhs_ros.learning.model.termination import Limits, fit_termination
from rkhs_ros.learning.model.transitions import Transitions
from rkhs_ros.policies.inputs import Inputs
from rkhs_ros.policies.spaces import Spaces
from rkhs_ros.rkhs.kernels import Array, deviations, spreads
from rkhs_ros.rkhs.posterior import Posterior

MARGIN = 0.25  # part of the observed range that rollouts may exceed it by: policies learn to exploit hard clipping
BEYOND = 0.5  # of the distance of two recorded initial observations, how far others may lie beyond them
VARYING = 0.1  # spread of the initial observations above which they vary, relative to that of the visited ones
FEWEST_VALUES = 10  # of a column that has limits; flags and other switches take fewer
MOST_TRANSITIONS = 20_000  # more make a fit slower but hardly better
NO_PRIORS = Priors()


@dataclass(frozen=True)
class DynamicsModel:
    """A probabilistic model of a task.

    Attributes:
        inputs: computes the model's inputs, besides the action, from the observations.
        spaces: spaces of the task.
        priors: functions that replace learnt parts.
        coordinates: coordinates of changes.
        state_delta: posterior of the change of the observation in a step, without the prior part.
        rewards: learnt rewards; None with a prior.
        termination: limits of the features beyond which an episode is terminated, or a posterior that is positive
            there; None with a prior, or if no episode was terminated.
        low: lower end of the observed range, shape (d,); -inf for periodic columns.
        high: upper end of the observed range, shape (d,); inf for periodic columns.
        takes_few_values: whether each column repeats a few values, such as a flag, shape (d,).
        least_reward: smallest observed reward of a non-terminal step.
        starts: observed initial observations, shape (N, d).
        starts_vary: whether initial observations may differ by more than a tenth of the spread of all observations.
        visited: observed observations before each step, shape (n, d).
    """

    inputs: Inputs
    spaces: Spaces
    priors: Priors
    coordinates: StateCoordinates
    state_delta: Posterior
    rewards: Rewards | None
    termination: Limits | Posterior | None
    low: Array
    high: Array
    takes_few_values: NDArray[np.bool_]
    least_reward: float
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
        changes = _residual_changes(steps, coordinates, priors)
        return cls(
            inputs=inputs,
            spaces=spaces,
            priors=priors,
            coordinates=coordinates,
            state_delta=Posterior.fit(steps.points, changes, centres, centred=centred),
            rewards=Rewards.fit(steps, inputs, spaces, centres) if priors.reward_fn is None else None,
            termination=_termination(steps, inputs, centres) if priors.termination_fn is None else None,
            **_bounds(steps, coordinates),
            least_reward=float(steps.rewards[steps.goes_on].min()),
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
        return self.possible(self.coordinates.add(self.priors.moved(observations, actions), changes, observations))

    def known_rewards(self, before: Array, actions: Array, after: Array) -> Array:
        """Return the known rewards of decisions, shape (n,): the discounted sum of those of their steps.

        The observations between the steps of a decision are not in the model; they lie on a straight way here.

        Args:
            before: observations, shape (n, d).
            actions: clipped actions, shape (n, m).
            after: next observations, shape (n, d).

        Raises:
            ValueError: the rewards are not known.
        """
        priors, way = self.priors, self.coordinates.difference(before, after)
        if priors.reward_fn is None:
            raise ValueError("model: expected a prior or a learnt reward, got neither")
        parts = np.arange(1, priors.action_repeat) / priors.action_repeat
        path = [before, *(self.coordinates.add(before, part * way) for part in parts), after]
        rewards = np.zeros(len(before))
        for step, (now, then) in enumerate(pairwise(path)):
            rewards += priors.discount**step * priors.reward_fn(now, actions, then)
        return rewards

    def least_rewards(self, actions: Array) -> Array:
        """Return the least observed rewards, but for a cost of clipped actions of shape (..., m): shape (...)."""
        if self.rewards is None:
            return np.full(actions.shape[:-1], self.least_reward)
        return self.rewards.of(np.full(actions.shape[:-1], -np.inf), actions, margin=0.0)

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
        """Return which numbers of observations, shape (..., d), lie at the limits of `possible`: shape (..., d).

        The model is wrong between the few values of a flag, but that does not mean that it knows little.
        """
        beyond = (observations <= self._lowest) | (observations >= self._highest)
        return np.asarray(beyond & ~self.takes_few_values)

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
        The root mean square error of the predicted changes, in standard deviations of the changes. Columns whose change
        is constant do not count, unless that is so for all.
    """
    earlier, steps = (
        Transitions.of(episodes, inputs, spaces).thinned(MOST_TRANSITIONS) for episodes in (before, after)
    )
    coordinates = coordinates_of(earlier, inputs)
    changes = _residual_changes(earlier, coordinates, priors)
    model = Posterior.fit(earlier.points, changes, centres, centred=centred)
    errors = coordinates.wrap(_residual_changes(steps, coordinates, priors) - model.mean(steps.points))
    changes = coordinates.difference(steps.observations, steps.next_observations)
    sizes, moving = np.sqrt(np.mean(errors**2, axis=0)) / deviations(changes), spreads(changes) > 0.0
    return float(np.sqrt(np.mean(sizes[moving if moving.any() else ...] ** 2)))


def coordinates_of(steps: Transitions, inputs: Inputs) -> StateCoordinates:
    """Return the coordinates in which the observations of steps change."""
    return StateCoordinates.of(np.concatenate([steps.observations, steps.next_observations]), inputs)


def _residual_changes(steps: Transitions, coordinates: StateCoordinates, priors: Priors) -> Array:
    """Return the changes of the observations without the prior part, shape (n, d)."""
    return coordinates.difference(priors.moved(steps.observations, steps.actions), steps.next_observations)


def _starts_vary(starts: Array, steps: Transitions, inputs: Inputs) -> bool:
    """Return whether the features of initial observations vary; a single one does not show it.

    Columns that change in one step by more than their spread are noise and have no effect.
    """
    if len(starts) == 1:
        return True
    initial, before, after = (inputs.features(each) for each in (starts, steps.observations, steps.next_observations))
    spread = spreads(before)
    is_state = (after - before).std(axis=0) < spread
    return bool((spreads(initial) > VARYING * spread)[is_state].any())


def _termination(steps: Transitions, inputs: Inputs, centres: int) -> Limits | Posterior | None:
    before, after = inputs.features(steps.observations), inputs.features(steps.next_observations)
    return fit_termination(before, after, steps.terminated, centres)


def _bounds(steps: Transitions, coordinates: StateCoordinates) -> dict[str, Any]:
    """Return the range of the observations, infinite for periodic columns, and which columns repeat a few values."""
    observed = np.concatenate([steps.observations, steps.next_observations])
    low, high = observed.min(axis=0), observed.max(axis=0)
    low[coordinates.periodic], high[coordinates.periodic] = -np.inf, np.inf
    distinct = np.array([len(np.unique(column)) for column in steps.observations.T])
    few = (distinct < FEWEST_VALUES) & (2 * distinct < len(steps.observations))
    return {"low": low, "high": high, "takes_few_values": few}
