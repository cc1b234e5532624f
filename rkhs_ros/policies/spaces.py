"""Observation and action spaces of a task."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from math import prod
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rkhs_ros.base.validation import require
from rkhs_ros.rkhs.kernels import Array

NO_BOUND = 1e30  # tasks give the largest 32-bit number for actions without bounds


@dataclass(frozen=True)
class Spaces:
    """The spaces of a task in its own shapes and types; policies use flat arrays.

    Attributes:
        observation_shape: shape of one observation.
        action_low: lower bound, in the shape and type of the task's actions; may be infinite.
        action_high: upper bound, in the same shape and type.
        observation_names: name and unit of each component of an observation; empty if the task has no names.
        action_names: name and unit of each component of an action; empty if the task has no names.
    """

    observation_shape: tuple[int, ...]
    action_low: NDArray[np.floating[Any]]
    action_high: NDArray[np.floating[Any]]
    observation_names: tuple[str, ...] = ()
    action_names: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        """Replace bounds that are none; raise ValueError if a shape, a bound or the number of names is invalid."""
        low, high = self.action_low, self.action_high
        good = all(isinstance(size, int) and size >= 0 for size in self.observation_shape)
        require(good, "observation_shape", "whole numbers >= 0", self.observation_shape)
        require(bool(np.issubdtype(low.dtype, np.floating)), "action_low", "real numbers", low.dtype)
        same = low.shape == high.shape and low.dtype == high.dtype
        require(same, "action_high", "the shape and type of action_low", high)
        require(bool((low <= high).all()), "action_low", "at most action_high", low)
        for name, bound in (("action_low", low), ("action_high", high)):
            is_bound = np.abs(bound.astype(np.float64)) < NO_BOUND
            object.__setattr__(self, name, np.where(is_bound, bound, np.copysign(np.inf, bound)))
        for kind, size in (("observation", self.observation_dim), ("action", self.action_dim)):
            names = getattr(self, f"{kind}_names")
            require(len(names) in (0, size), f"{kind}_names", f"{size} names or none", ", ".join(names))

    @classmethod
    def unbounded(cls, observation_dim: int, action_dim: int) -> Spaces:
        """Return flat, unbounded spaces."""
        return cls((observation_dim,), np.full(action_dim, -np.inf), np.full(action_dim, np.inf))

    @property
    def observation_dim(self) -> int:
        """Number of components of an observation."""
        return prod(self.observation_shape)

    @property
    def action_dim(self) -> int:
        """Number of components of an action."""
        return int(self.action_low.size)

    def clip(self, actions: Array) -> Array:
        """Return actions, shape (batch, action_dim), clipped to the bounds."""
        low, high = self._bounds
        return np.minimum(np.maximum(actions, low), high)  # several times faster than numpy.clip for few values

    @property
    def half_ranges(self) -> Array:
        """Half the range of each action, shape (action_dim,); 1 if the range is infinite or zero."""
        low, high = self._bounds
        return np.where(np.isfinite(high - low) & (high > low), 0.5 * (high - low), 1.0)

    @property
    def middle(self) -> tuple[float, ...]:
        """Middle of the range of each action, 0 if the range is infinite; empty if all are 0."""
        low, high = self._bounds
        middle = 0.5 * np.add(low, high, out=np.zeros(len(low)), where=np.isfinite(high - low))
        return tuple(middle.tolist()) if middle.any() else ()

    @cached_property
    def _bounds(self) -> tuple[Array, Array]:
        return self.action_low.ravel().astype(np.float64), self.action_high.ravel().astype(np.float64)

    def shaped(self, actions: Array) -> NDArray[np.floating[Any]]:
        """Return clipped actions, shape (batch, action_dim), in the task's shape and type: shape (batch, ...)."""
        shape = (len(actions), *self.action_low.shape)
        return self.clip(actions).reshape(shape).astype(self.action_low.dtype, copy=False)

    def rows(self, observations: Any) -> tuple[Array, bool]:
        """Return one observation or a batch as a matrix with one row each, and whether it was a single one.

        Raises:
            ValueError: the shape is neither that of an observation nor that of a batch.
        """
        array = np.array(observations, dtype=np.float64)  # a copy, because the caller may reuse the array
        one = array.shape == self.observation_shape
        good = one or array.shape[1:] == self.observation_shape
        require(good, "observation", f"the shape {self.observation_shape} or a batch of it", array.shape)
        return array.reshape(-1, self.observation_dim), one
