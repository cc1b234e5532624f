"""Draw pairs of inputs that lie on a circle, such as a cosine and a sine, as one angle."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rkhs_ros.learning.model.state_coordinates import StateCoordinates
from rkhs_ros.rkhs.kernels import Array


@dataclass(frozen=True)
class CircleAxes:
    """Axes of a plot over points whose pairs of columns on a circle about 0 are one axis each.

    Attributes:
        state: columns of the points, with the pairs on a circle.
        radii: radius of each circle.
    """

    state: StateCoordinates
    radii: tuple[float, ...]

    @classmethod
    def of(cls, points: Array) -> CircleAxes:
        """Find the pairs that lie on a circle at visited points, shape (k, d)."""
        state = StateCoordinates.of(points)
        return cls(state, tuple(float(np.hypot(points[:, i], points[:, j]).mean()) for i, j in state.circles))

    def labels(self, names: tuple[str, ...]) -> tuple[str, ...]:
        """Return the names of the axes, given the names of the columns."""
        angles = {i: f"angle of ({names[i]}, {names[j]}) (rad)" for i, j in self.state.circles}
        return tuple(angles.get(column, names[column]) for column in self.state.columns)

    def angles(self, points: Array) -> Array:
        """Return points of shape (k, d) on the axes, shape (k, axes)."""
        turned = points.copy()
        for i, j in self.state.circles:
            turned[:, i] = np.arctan2(points[:, j], points[:, i])
        return turned[:, self.state.columns]

    def points(self, angles: Array) -> Array:
        """Return the points, shape (k, d), at positions on the axes, shape (k, axes)."""
        points = np.empty((len(angles), self.state.size))
        points[:, self.state.columns] = angles
        for (i, j), radius in zip(self.state.circles, self.radii, strict=True):
            angle = points[:, i].copy()
            points[:, i], points[:, j] = radius * np.cos(angle), radius * np.sin(angle)
        return points
