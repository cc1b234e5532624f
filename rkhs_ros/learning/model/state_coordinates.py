"""How observations change: angles the short way round, and points of circles along these."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from rkhs_ros.rkhs.kernels import Array

ROUND = 1e-4  # relative spread of the squared radii of a circle at most: observations may be rounded to 32 bits
FEWEST_ON_CIRCLE = 10  # different points that tell a circle from two flags


@dataclass(frozen=True)
class StateCoordinates:
    r"""The coordinates in which an observation changes.

    An angle is told modulo :math:`2 \pi`. Two numbers that keep to a circle about 0, as a cosine and a sine, change by
    the angle between them, told in the first one's place; in the other's is 0. What is imagined thus stays on the
    circle, where all was seen that is known.

    Attributes:
        size: numbers d in an observation.
        angles: columns.
        circles: pairs of columns.
    """

    size: int
    angles: Sequence[int] = ()
    circles: tuple[tuple[int, int], ...] = ()

    @classmethod
    def of(cls, observations: Array, angles: Sequence[int] = ()) -> StateCoordinates:
        """Return the motion of a task of which observations were seen, shape (n, d); some columns may be angles."""
        squares, free, circles = observations**2, set(range(observations.shape[1])) - set(angles), []
        for pair in combinations(sorted(free), 2):
            if free.issuperset(pair) and _on_circle(squares[:, pair[0]] + squares[:, pair[1]], squares[:, pair[0]]):
                circles.append(pair)
                free -= set(pair)
        return cls(observations.shape[1], angles, tuple(circles))

    @property
    def columns(self) -> list[int]:
        """Columns in which changes are told."""
        return sorted(set(range(self.size)) - {j for _, j in self.circles})

    @property
    def periodic(self) -> list[int]:
        """Columns of what comes round."""
        return [*self.angles, *(column for pair in self.circles for column in pair)]

    def difference(self, before: Array, after: Array) -> Array:
        """Return how observations, shape (n, d), changed to others."""
        changes = after - before
        for i, j in self.circles:
            changes[:, i], changes[:, j] = _angle(after, i, j) - _angle(before, i, j), 0.0
        return self.wrap(changes)

    def wrap(self, changes: Array) -> Array:
        """Return changes, shape (n, d), with those of angles in [-pi, pi)."""
        columns = [*self.angles, *(i for i, _ in self.circles)]
        if not columns:
            return changes
        short = changes.copy()
        short[:, columns] = _short(changes[:, columns])
        return short

    def add(self, before: Array, changes: Array) -> Array:
        """Return what observations, shape (n, d), change to."""
        moved = before + changes
        if self.angles:
            moved[:, self.angles] = _short(moved[:, self.angles])
        for i, j in self.circles:
            radius, angle = np.hypot(before[:, i], before[:, j]), _angle(before, i, j) + changes[:, i]
            moved[:, i], moved[:, j] = radius * np.cos(angle), radius * np.sin(angle)
        return moved


def _on_circle(radii: Array, parts: Array) -> bool:
    """Return whether squared radii are all but the same where the first coordinate's square, a part of them, is not."""
    mean = radii.mean()
    return bool(np.ptp(radii) < ROUND * mean and len(np.unique(parts)) >= FEWEST_ON_CIRCLE)


def _angle(points: Array, i: int, j: int) -> Array:
    return np.asarray(np.arctan2(points[:, j], points[:, i]))


def _short(angles: Array) -> Array:
    return np.asarray(np.remainder(angles + np.pi, 2.0 * np.pi) - np.pi)
