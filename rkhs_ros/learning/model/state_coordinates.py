"""Coordinates in which observations change: differences of angles are periodic, and pairs on a circle are rotated."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from rkhs_ros.policies.inputs import Inputs
from rkhs_ros.rkhs.kernels import Array

ROUND = 1e-4  # largest relative spread of a circle's squared radii; observations may be rounded to 32 bits
ARC = 0.1  # the same, relative to that of the first coordinate's squares: columns far from 0 are no circle
RADIANS = 2.0 * np.pi  # a full turn
NO_ANGLES = Inputs()
FEWEST_ON_CIRCLE = 10  # distinct points that distinguish a circle from a pair of flags


@dataclass(frozen=True)
class StateCoordinates:
    r"""The coordinates in which the model predicts the change of an observation.

    Angles are periodic, modulo a full turn. A pair of columns whose observations lie on a circle about 0, such as a
    cosine and a sine, changes by a rotation: its angle replaces the change of the first column, and the change of the
    second is 0. Predicted pairs therefore keep their distance from 0.

    Attributes:
        size: dimension d of an observation.
        angles: columns that are angles.
        turns: value of a full turn of each angle, shape (angles,).
        circles: pairs of columns that lie on a circle.
    """

    size: int
    angles: Sequence[int]
    turns: Array
    circles: tuple[tuple[int, int], ...] = ()

    @classmethod
    def of(cls, observations: Array, inputs: Inputs = NO_ANGLES) -> StateCoordinates:
        """Find the coordinates of a task from observations, shape (n, d), and the columns that are angles."""
        squares, free, circles = observations**2, set(range(observations.shape[1])) - set(inputs.columns), []
        for pair in combinations(sorted(free), 2):
            if free.issuperset(pair) and _on_circle(squares[:, pair[0]] + squares[:, pair[1]], squares[:, pair[0]]):
                circles.append(pair)
                free -= set(pair)
        return cls(observations.shape[1], inputs.columns, inputs.full_turns, tuple(circles))

    @property
    def columns(self) -> list[int]:
        """Columns with a change; the second columns of circles have none."""
        return sorted(set(range(self.size)) - {j for _, j in self.circles})

    @property
    def periodic(self) -> list[int]:
        """Columns that are periodic: angles and circles."""
        return [*self.angles, *(column for pair in self.circles for column in pair)]

    def difference(self, before: Array, after: Array) -> Array:
        """Return the changes between observations, shape (n, d)."""
        changes = after - before
        for i, j in self.circles:
            changes[:, i], changes[:, j] = _angle(after, i, j) - _angle(before, i, j), 0.0
        return self.wrap(changes)

    def wrap(self, changes: Array) -> Array:
        """Return changes, shape (n, d), with those of angles wrapped to at most half a turn."""
        columns = [*self.angles, *(i for i, _ in self.circles)]
        if not columns:
            return changes
        short, turns = changes.copy(), np.append(self.turns, np.full(len(self.circles), RADIANS))
        short[:, columns] = _short(changes[:, columns], turns)
        return short

    def add(self, before: Array, changes: Array, near: Array | None = None) -> Array:
        """Return observations, shape (n, d), after changes; pairs on a circle keep the distance of ``near``, if given.

        The changes are those from ``before``, which may have left the circle.
        """
        moved = before + changes
        if self.angles:
            moved[:, self.angles] = _short(moved[:, self.angles], self.turns)
        for i, j in self.circles:
            on = before if near is None else near
            radius, angle = np.hypot(on[:, i], on[:, j]), _angle(before, i, j) + changes[:, i]
            moved[:, i], moved[:, j] = radius * np.cos(angle), radius * np.sin(angle)
        return moved


def _on_circle(radii: Array, parts: Array) -> bool:
    """Return whether squared radii are nearly constant while ``parts``, the first coordinate's square, varies."""
    is_round = np.ptp(radii) < min(ROUND * radii.mean(), ARC * np.ptp(parts))
    return bool(is_round and len(np.unique(parts)) >= FEWEST_ON_CIRCLE)


def _angle(points: Array, i: int, j: int) -> Array:
    return np.asarray(np.arctan2(points[:, j], points[:, i]))


def _short(angles: Array, turns: Array) -> Array:
    """Return angles, shape (n, k), wrapped to [-1/2, 1/2) of a full turn."""
    return np.asarray(np.remainder(angles + 0.5 * turns, turns) - 0.5 * turns)
