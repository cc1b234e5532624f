r"""Regression that knows what it does not know: a Gaussian process in a Newton basis.

The prior is a sum of a constant, a linear function and a function of an RKHS, in units in which points and targets
have mean 0 and standard deviation 1:

.. math:: y = f(x) + \epsilon, \qquad f \sim GP\big(0,\ s^2 (\kappa(x, x') + \tau^2 (1 + x \cdot x'))\big), \qquad
    \epsilon \sim N(0, \lambda s^2)

Distances are measured in coordinates that are stretched where the evidence prefers it. With all points as centres this
is the Gaussian process itself; with m of them it costs O(n m^2) for n points.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from rkhs_ros.rkhs.evidence import LINEAR_SD, Coefficients, features_of
from rkhs_ros.rkhs.kernels import Array, spreads
from rkhs_ros.rkhs.metric_learning import fit_metric
from rkhs_ros.rkhs.newton import NewtonBasis
from rkhs_ros.rkhs.standardizer import Coordinates, Standardizer


@dataclass(frozen=True)
class Posterior:
    """A distribution of functions from d to k dimensions, given values of them.

    Attributes:
        points: the coordinates of points.
        targets: the units of values.
        basis: of the kernel part, on points in their coordinates.
        coefficients: of the constant, the linear and the kernel part.
        evidence: logarithm of the density of the values in their units, less a constant.
    """

    points: Coordinates
    targets: Standardizer
    basis: NewtonBasis
    coefficients: Coefficients
    evidence: float

    @classmethod
    def fit(cls, points: Array, targets: Array, centres: int, weights: Array | None = None) -> Posterior:
        """Return the posterior with the coordinates, the bandwidth and the noises of the greatest evidence.

        Constant targets have no say in the bandwidth.

        Args:
            points: shape (n, d), n at least 1.
            targets: shape (n, k).
            centres: of the kernel part at most.
            weights: how often each point counts, shape (n,); once where None.
        """
        units, of_targets = Standardizer.of(points, weights), Standardizer.of(targets, weights)
        y = np.where(spreads(targets, weights) > 0, of_targets.standardise(targets), 0.0)
        roots = np.ones((len(points), 1)) if weights is None else np.sqrt(weights)[:, None]
        coordinates, best = fit_metric(Coordinates(units), points, y, roots, centres)
        return cls(coordinates, of_targets, best.basis, best.coefficients, best.evidence)

    def features(self, points: Array) -> Array:
        """Return constant, linear and kernel features at points of shape (n, d), shape (n, p)."""
        x = self.points.of(points)
        return features_of(x, self.basis(x))

    def mean(self, points: Array) -> Array:
        """Return the expected values at points of shape (n, d), shape (n, k)."""
        return self.targets.restore(self.features(points) @ self.coefficients.mean)

    def sd(self, points: Array) -> Array:
        """Return the standard deviations of the functions' values at points of shape (n, d), shape (n, k).

        What the centres' span leaves out counts: far from all centres the kernel part is as uncertain as before.
        """
        features = self.features(points)
        kernel_part = features[:, self.linear_size :]
        left = np.maximum(1.0 - np.sum(kernel_part**2, axis=1), 0.0)  # of kappa(x, x) = 1
        inside = (features @ self.coefficients.axes) ** 2 @ self.coefficients.sd**2
        return np.asarray(np.sqrt(inside + left[:, None] * self.coefficients.signal**2) * self.targets.scale)

    @property
    def noise(self) -> Array:
        """Standard deviation of the values about the functions, shape (k,)."""
        return self.coefficients.noise * self.targets.scale

    @property
    def linear_size(self) -> int:
        """Number of features that are constant or linear, 1 + d."""
        return 1 + self.points.dimension

    def draw(self, normals: Array) -> DrawnFunctions:
        """Return functions drawn from the posterior; what the centres' span leaves out is 0, its mean.

        Args:
            normals: standard normal draws, shape (rows, k, p); 0 for the mean.
        """
        axes, mean, sd, _, _ = self.coefficients
        weights = np.matmul((axes.T @ mean).T + sd.T * normals, self._directions.T) * self.targets.scale[:, None]
        weights[:, :, 0] += self.targets.centre
        return DrawnFunctions(self.points, self.basis.kernel.with_centres(self.basis.centres), weights)

    @cached_property
    def _directions(self) -> Array:
        """The coefficients' axes as weights of 1, x and the kernel functions, one axis a column, shape (p, p)."""
        linear, kernel = np.split(self.coefficients.axes, [self.linear_size])
        return np.concatenate([LINEAR_SD * linear, self.basis.weights(kernel)])


@dataclass(frozen=True)
class DrawnFunctions:
    """Functions drawn from a posterior, k for each row.

    Attributes:
        points: the coordinates of points.
        kernel: from points in their coordinates to their kernel with m centres.
        weights: of 1, of points in their coordinates and of the kernel, shape (rows, k, 1 + d + m).
    """

    points: Coordinates
    kernel: Callable[[Array], Array]
    weights: Array

    def __call__(self, points: Array) -> Array:
        """Evaluate each row's functions at its point, points of shape (rows, d): shape (rows, k).

        The values of a row depend on that row alone, to the last bit.
        """
        return np.asarray(np.matmul(self.weights, self._features(points)[:, :, None])[:, :, 0])

    def of_row(self, row: int, points: Array) -> Array:
        """Evaluate one row's functions at points of shape (n, d): shape (n, k)."""
        return np.asarray(self._features(points) @ self.weights[row].T)

    def _features(self, points: Array) -> Array:
        x = self.points.of(points)
        return np.concatenate([np.ones((len(x), 1)), x, self.kernel(x)], axis=1)
