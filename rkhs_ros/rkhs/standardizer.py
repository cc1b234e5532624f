"""Units by which columns of numbers become comparable, and coordinates in which distances are measured."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rkhs_ros.rkhs.kernels import Array, deviations, rowwise_matmul


@dataclass(frozen=True)
class Standardizer:
    """Mean and standard deviation of each column, by which they become comparable.

    Attributes:
        centre: shape (d,).
        scale: shape (d,), positive; 1 where a column is constant but for rounding.
    """

    centre: Array
    scale: Array

    @classmethod
    def of(cls, values: Array, weights: Array | None = None) -> Standardizer:
        """Return the units of the columns of values, shape (n, d), n at least 1, each counted as often as it weighs."""
        return cls(np.average(values, axis=0, weights=weights), deviations(values, weights))

    def standardise(self, values: Array) -> Array:
        """Return values in these units."""
        return (values - self.centre) / self.scale

    def restore(self, values: Array) -> Array:
        """Return values that were in these units."""
        return values * self.scale + self.centre


@dataclass(frozen=True)
class Coordinates:
    r"""Where points are to a kernel: in units of each column, and along axes that are stretched.

    .. math:: z = (x - c) / s \cdot L, \qquad |z - z'|^2 = (x - x') / s \cdot L L^\top \cdot ((x - x') / s)^\top

    Attributes:
        units: c and s.
        axes: L, shape (d, d), the squares of whose entries sum up to d; None for the identity.
    """

    units: Standardizer
    axes: Array | None = None

    @property
    def dimension(self) -> int:
        """Number d of coordinates."""
        return len(self.units.centre)

    def of(self, points: Array) -> Array:
        """Return the coordinates of points, shape (n, d); those of a row depend on that row alone, to the last bit."""
        x = self.units.standardise(points)
        return x if self.axes is None else rowwise_matmul(x, self.axes)
