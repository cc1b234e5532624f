"""Standardise columns of numbers, and define the coordinates in which kernels measure distances."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rkhs_ros.rkhs.kernels import Array, deviations, rowwise_matmul


@dataclass(frozen=True)
class Standardizer:
    """Mean and standard deviation of each column, used to standardise it.

    Attributes:
        centre: means, shape (d,).
        scale: standard deviations, shape (d,), positive; 1 for a column that is constant up to rounding.
    """

    centre: Array
    scale: Array

    @classmethod
    def of(cls, values: Array, weights: Array | None = None) -> Standardizer:
        """Fit the mean and standard deviation of the columns of values, shape (n, d), n at least 1, with weights."""
        return cls(np.average(values, axis=0, weights=weights), deviations(values, weights))

    def standardise(self, values: Array) -> Array:
        """Return standardised values."""
        return (values - self.centre) / self.scale

    def restore(self, values: Array) -> Array:
        """Return values in their original units."""
        return values * self.scale + self.centre


@dataclass(frozen=True)
class Coordinates:
    r"""Coordinates in which a kernel measures distances: standardised columns, optionally with a learnt metric.

    .. math:: z = (x - c) / s \cdot L, \qquad |z - z'|^2 = (x - x') / s \cdot L L^\top \cdot ((x - x') / s)^\top

    Attributes:
        units: means c and standard deviations s.
        axes: L, shape (d, d), with squared entries that sum to d; None for the identity.
    """

    units: Standardizer
    axes: Array | None = None

    @property
    def dimension(self) -> int:
        """Number d of coordinates."""
        return len(self.units.centre)

    def of(self, points: Array) -> Array:
        """Return the coordinates of points, shape (n, d); each row depends only on itself, bit-identically."""
        x = self.units.standardise(points)
        return x if self.axes is None else rowwise_matmul(x, self.axes)
