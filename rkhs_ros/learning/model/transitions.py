"""The transitions of episodes, from which a model learns."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rkhs_ros.learning.episodes import Episodes
from rkhs_ros.policies.inputs import Inputs
from rkhs_ros.policies.spaces import Spaces
from rkhs_ros.rkhs.kernels import Array


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

    @property
    def goes_on(self) -> NDArray[np.bool_]:
        """Whether the task goes on after each step; if it never does, the steps count as if it did."""
        return np.ones_like(self.terminated) if self.terminated.all() else ~self.terminated

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
