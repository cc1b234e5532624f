"""Inputs of the policy functions: windows of past observations and actions, their features, and their names."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from itertools import combinations_with_replacement
from math import comb, prod
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from rkhs_ros.base.settings import Settings, setting
from rkhs_ros.base.validation import require
from rkhs_ros.policies.spaces import Spaces
from rkhs_ros.rkhs.kernels import Array

MOST_INPUTS = 100_000  # numbers of an observation or an input


@dataclass(frozen=True)
class Inputs(Settings):
    r"""The map from a history :math:`(o_0, a_0, \dots, o_t)` to the input of the policy's functions.

    The policy evaluates it step by step; the learner evaluates all steps at once. Actions are clipped to their bounds,
    as in the task. The bounds are not settings: `within` takes them from the task. ``degree`` and ``offset`` of
    monomials follow from ``kernel.form=monomials``.
    """

    history: int = setting(
        1,
        "length of the input window: the last observations, each with the preceding action; "
        "1: the current observation only",
        minimum=1,
        maximum=1000,
    )
    angles: str | tuple[float, ...] = setting(
        "none",
        "observation columns that are angles, replaced by their sine and cosine; or 'none'",
        minimum=0,
        maximum=10_000,
        choices=("none",),
    )
    turns: tuple[float, ...] = setting(
        (), "value of a full turn of each angle, such as 360; empty for radians", minimum=1e-12, maximum=1e12
    )
    degree: int = 0  # of the monomials that replace the inputs; 0: no monomials
    offset: float = 1.0  # c of the polynomial kernel that the monomials span
    action_low: tuple[float, ...] = field(default=(), compare=False)  # empty: unbounded
    action_high: tuple[float, ...] = field(default=(), compare=False)

    def __post_init__(self) -> None:
        """Raise ValueError if a value is invalid or a column is not a whole number."""
        super().__post_init__()
        whole = isinstance(self.angles, str) or all(column == int(column) for column in self.angles)
        require(whole, "inputs.angles", "whole numbers", self.angles)
        require(len(set(self.columns)) == len(self.columns), "inputs.angles", "each column once", self.angles)
        good = len(self.turns) in (0, len(self.columns))
        require(good, "inputs.turns", f"{len(self.columns)} numbers, one per angle, or none", self.turns)
        good = isinstance(self.degree, int) and 0 <= self.degree <= 20 and 0 <= self.offset <= 1e6
        require(good, "monomials", "a degree of 0 to 20 and an offset of 0 to 1e6", (self.degree, self.offset))
        bounds = (self.action_low, self.action_high)
        good = len(bounds[0]) == len(bounds[1]) and all(low <= high for low, high in zip(*bounds, strict=True))
        require(good, "inputs.action_low", "a number for each action, at most that of action_high", bounds)

    def within(self, spaces: Spaces) -> Inputs:
        """Return the inputs with the action bounds of a task."""
        low, high = (tuple(bound.ravel().tolist()) for bound in (spaces.action_low, spaces.action_high))
        return replace(self, action_low=low, action_high=high)

    @property
    def columns(self) -> list[int]:
        """Observation columns that are angles."""
        return [] if isinstance(self.angles, str) else [int(column) for column in self.angles]

    @property
    def full_turns(self) -> Array:
        """Value of a full turn of each angle, shape (len(columns),)."""
        return np.array(self.turns) if self.turns else np.full(len(self.columns), 2.0 * np.pi)

    def is_equivalent_to(self, other: Inputs) -> bool:
        """Return whether the inputs are the same function: empty turns equal turns in radians."""
        own, others = (replace(each, turns=tuple(each.full_turns.tolist())) for each in (self, other))
        return own == others

    @property
    def turns_by_column(self) -> dict[int, float]:
        """Value of a full turn of each angle, by its column."""
        return dict(zip(self.columns, self.full_turns.tolist(), strict=True))

    @property
    def ages(self) -> int:
        """Number of time steps in an input; 1 if monomials mix them."""
        return 1 if self.degree else self.history

    def dimension(self, observation_dim: int, action_dim: int) -> int:
        """Return the dimension of the inputs.

        Raises:
            ValueError: an angle is not a column of the observation, or there are too many inputs.
        """
        self._check_angles(observation_dim)
        observed = observation_dim + len(self.columns)
        size = observed if self.history == 1 else self.history * (observed + action_dim)
        size = comb(size + self.degree, self.degree) if self.degree else size
        require(size <= MOST_INPUTS, "inputs", f"at most {MOST_INPUTS} numbers", size)
        return size

    def unfold(self, observations: Array, actions: Array) -> Array:
        """Return the inputs at all steps, shape (num_envs, horizon, input_dim).

        Args:
            observations: observations before each action, shape (num_envs, horizon, d).
            actions: actions of each step, shape (num_envs, horizon, n).
        """
        return self.at(np.arange(observations.shape[1]), observations, actions)

    def at(self, steps: NDArray[np.int_], observations: Array, actions: Array) -> Array:
        """Return the inputs at some steps, shape (num_envs, len(steps), input_dim).

        Before the start of an episode, the window repeats the first observation with zero actions, clipped as well.
        The inputs of an environment are bit-identical for any number of other environments.
        """
        if self.history == 1:
            return self.features(observations[:, steps])
        ago = np.arange(self.history - 1, -1, -1)
        places = steps[:, None] - ago
        observed = self._angles(observations[:, np.maximum(places, 0)])
        done = np.where(places[:, :, None] > 0, actions[:, np.maximum(places - 1, 0)], 0.0)
        if self.action_low:
            done = np.minimum(np.maximum(done, self.action_low), self.action_high)
        windows = np.concatenate([observed, done], axis=-1)
        num_envs, length, ages, columns = windows.shape
        return self._monomials(windows.reshape(num_envs, length, ages * columns))

    def features(self, observations: Array) -> Array:
        """Return the inputs for a window of length 1, shape (..., input_dim)."""
        return self._monomials(self._angles(observations))

    def _check_angles(self, observation_dim: int) -> None:
        good = max(self.columns, default=0) < observation_dim
        require(good, "inputs.angles", f"columns from 0 to {observation_dim - 1}", self.angles)

    def _angles(self, observations: Array) -> Array:
        if not self.columns:
            return observations
        self._check_angles(observations.shape[-1])
        turned = observations[..., self.columns] * (2.0 * np.pi / self.full_turns)
        rest = np.delete(observations, self.columns, axis=-1)
        return np.concatenate([np.sin(turned), np.cos(turned), rest], axis=-1)

    def _monomials(self, x: Array) -> Array:
        r"""Return the monomials whose inner products are the polynomial kernel.

        .. math:: (x \cdot y + c)^p = \phi(x) \cdot \phi(y)

        In these coordinates a small offset loses no precision, unlike in the kernel's Gram matrix. The result is in C
        order, because another memory order can change the last bits of products.
        """
        if self.degree == 0:
            return np.ascontiguousarray(x)
        choices, scale, constant = self.monomials(x.shape[-1])
        factors = np.concatenate([x, np.full((*x.shape[:-1], 1), constant)], axis=-1)
        return np.ascontiguousarray(scale * factors[..., choices].prod(axis=-1))

    def monomials(self, size: int) -> tuple[NDArray[np.int_], Array, float]:
        """Return the monomials of ``size`` numbers, to which a constant is appended.

        Returns:
            The columns of the factors, shape (count, degree); the coefficients, shape (count,); the constant.
        """
        choices = list(combinations_with_replacement(range(size + 1), self.degree))
        scale = np.sqrt([_multinomial(np.bincount(c, minlength=size + 1).tolist()) for c in choices])
        return np.array(choices), scale, float(np.sqrt(self.offset))


class Window:
    """The inputs of the current step of episodes that run.

    Owns the last observations and actions. Before the start of an episode, it repeats the first observation with zero
    actions.

    Args:
        inputs: the map to the inputs.
        action_dim: dimension n of an action.
    """

    def __init__(self, inputs: Inputs, action_dim: int) -> None:
        self._inputs = inputs
        self._action_dim = action_dim
        self._past: tuple[Array, Array] | None = None  # observations, one more than actions, and actions

    def observed(self, observations: Array) -> Array:
        """Return the inputs of a step, shape (num_envs, input_dim), for observations of shape (num_envs, d)."""
        history, newest = self._inputs.history, observations[:, None]
        if history == 1:
            return self._inputs.features(observations)
        if self._past is None:
            actions = np.zeros((len(observations), history, self._action_dim))
            self._past = np.repeat(newest, history + 1, axis=1), actions
        else:
            before, actions = self._past
            self._past = np.concatenate([before[:, 1:], newest], axis=1), actions
        return self._inputs.at(np.array([history]), *self._past)[:, 0]

    def acted(self, actions: Array) -> None:
        """Append the actions of the step, shape (num_envs, n)."""
        if self._past is not None:
            observations, before = self._past
            self._past = observations, np.concatenate([before[:, 1:], actions[:, None]], axis=1)


def _multinomial(counts: Sequence[int]) -> int:
    return prod(comb(sum(counts[: i + 1]), count) for i, count in enumerate(counts))


UNIT = re.compile(r"\s*\([^()]*\)$")


class Names(NamedTuple):
    """Names of the components of a task's observations and actions, with units."""

    observations: tuple[str, ...]
    actions: tuple[str, ...]


def default_names(kind: str, count: int) -> tuple[str, ...]:
    """Return default names such as "observation 0"."""
    return tuple(f"{kind} {i}" if count > 1 else kind for i in range(count))


def reported_names(names: object, count: int) -> tuple[str, ...]:
    """Return the names that user code reports if they are ``count`` strings, else an empty tuple."""
    good = isinstance(names, list | tuple) and len(names) == count and all(isinstance(name, str) for name in names)
    return tuple(names) if good else ()  # type: ignore[arg-type]


def input_names(inputs: Inputs, names: Names, action_repeat: int = 1) -> tuple[str, ...]:
    """Return the names of the policy's inputs in their order.

    Args:
        inputs: the inputs.
        names: names of a task's components.
        action_repeat: number of steps per decision; the entries of a history are one decision apart.
    """
    observed = _with_angles(names.observations, inputs.columns)
    if inputs.history > 1:
        ages = range((inputs.history - 1) * action_repeat, -1, -action_repeat)
        earlier = ((_with_age(observed, ago), _with_age(names.actions, ago + action_repeat)) for ago in ages)
        observed = [name for both in earlier for part in both for name in part]
    if inputs.degree == 0:
        return tuple(observed)
    chosen = combinations_with_replacement(range(len(observed) + 1), inputs.degree)
    return tuple(" · ".join(observed[i] for i in columns if i < len(observed)) or "constant" for columns in chosen)


def _with_angles(observations: Sequence[str], angles: Sequence[int]) -> list[str]:
    turned = [UNIT.sub("", observations[column]) for column in angles]
    rest = [name for column, name in enumerate(observations) if column not in angles]
    return [f"{function} of {name}" for function in ("sine", "cosine") for name in turned] + rest


def _with_age(names: Sequence[str], ago: int) -> list[str]:
    return [f"{name}, {ago} step{'s' * (ago > 1)} ago" for name in names] if ago else list(names)
