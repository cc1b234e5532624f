r"""Gaussian-process regression in a Newton basis.

The prior is the sum of a constant, a linear function and a function of an RKHS. Points and targets are standardised to
mean 0 and standard deviation 1:

.. math:: y = f(x) + \epsilon, \qquad f \sim GP\big(0,\ s^2 (\kappa(x, x') + \tau^2 (1 + x \cdot x'))\big), \qquad
    \epsilon \sim N(0, \lambda s^2)

A learnt metric replaces plain distances if its evidence is greater. With all points as centres the regression is the
exact Gaussian process; with m centres it takes O(n m^2) for n points.
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
    """The posterior distribution of functions from d to k dimensions.

    Attributes:
        points: maps points to coordinates.
        targets: standardises the targets.
        basis: basis of the kernel part, as a function of coordinates.
        coefficients: posterior of the coefficients of the constant, the linear and the kernel part.
        evidence: log density of the standardised targets, up to a constant.
    """

    points: Coordinates
    targets: Standardizer
    basis: NewtonBasis
    coefficients: Coefficients
    evidence: float

    @classmethod
    def fit(
        cls, points: Array, targets: Array, centres: int, weights: Array | None = None, *, centred: bool = False
    ) -> Posterior:
        """Fit the posterior with the coordinates, the bandwidth and the noises of the greatest evidence.

        Constant targets do not affect the bandwidth.

        Args:
            points: shape (n, d), n at least 1.
            targets: shape (n, k).
            centres: maximum number of centres of the kernel part.
            weights: weight of each point, shape (n,); None for 1.
            centred: also try the centred metric; see `rkhs_ros.rkhs.metric_learning`.
        """
        units, of_targets = Standardizer.of(points, weights), Standardizer.of(targets, weights)
        y = np.where(spreads(targets, weights) > 0, of_targets.standardise(targets), 0.0)
        roots = np.ones((len(points), 1)) if weights is None else np.sqrt(weights)[:, None]
        coordinates, best = fit_metric(Coordinates(units), points, y, roots, centres, centred=centred)
        return cls(coordinates, of_targets, best.basis, best.coefficients, best.evidence)

    def features(self, points: Array) -> Array:
        """Return the constant, linear and kernel features of points of shape (n, d): shape (n, p)."""
        x = self.points.of(points)
        return features_of(x, self.basis(x))

    def mean(self, points: Array) -> Array:
        """Return the mean values at points of shape (n, d): shape (n, k)."""
        return self.targets.restore(self.features(points) @ self.coefficients.mean)

    def sd(self, points: Array) -> Array:
        """Return the standard deviations of the functions' values at points of shape (n, d): shape (n, k).

        They include the variance outside the span of the centres, so the prior's uncertainty returns far from them.
        """
        features = self.features(points)
        kernel_part = features[:, self.linear_size :]
        left = np.maximum(1.0 - np.sum(kernel_part**2, axis=1), 0.0)  # outside the span; kappa(x, x) = 1
        inside = (features @ self.coefficients.axes) ** 2 @ self.coefficients.sd**2
        return np.asarray(np.sqrt(inside + left[:, None] * self.coefficients.signal**2) * self.targets.scale)

    @property
    def noise(self) -> Array:
        """Standard deviation of the targets about the functions, shape (k,)."""
        return self.coefficients.noise * self.targets.scale

    @property
    def linear_size(self) -> int:
        """Number of constant and linear features, 1 + d."""
        return 1 + self.points.dimension

    def draw(self, normals: Array) -> DrawnFunctions:
        """Return functions drawn from the posterior; their part outside the span of the centres is its mean, 0.

        Args:
            normals: standard normal draws, shape (draws, k, p); 0 gives the posterior mean.
        """
        axes, mean, sd, _, _ = self.coefficients
        weights = np.matmul((axes.T @ mean).T + sd.T * normals, self._directions.T) * self.targets.scale[:, None]
        weights[:, :, 0] += self.targets.centre
        return DrawnFunctions(self.points, self.basis.kernel.with_centres(self.basis.centres), weights)

    @cached_property
    def _directions(self) -> Array:
        """The coefficients' axes as weights of 1, x and the kernel functions, one axis per column, shape (p, p)."""
        linear, kernel = np.split(self.coefficients.axes, [self.linear_size])
        return np.concatenate([LINEAR_SD * linear, self.basis.weights(kernel)])


@dataclass(frozen=True)
class DrawnFunctions:
    """Functions drawn from a posterior: each draw consists of k functions.

    Attributes:
        points: maps points to coordinates.
        kernel: maps coordinates to their kernel with m centres.
        weights: weights of 1, of the coordinates and of the kernel, shape (draws, k, 1 + d + m).
    """

    points: Coordinates
    kernel: Callable[[Array], Array]
    weights: Array

    def __call__(self, points: Array) -> Array:
        """Evaluate each draw at its own point, points of shape (draws, d): shape (draws, k).

        The values of a draw do not depend on the others; this holds bit-identically.
        """
        return np.asarray(np.matmul(self.weights, self._features(points)[:, :, None])[:, :, 0])

    def of_draw(self, draw: int, points: Array) -> Array:
        """Evaluate one draw at points of shape (n, d): shape (n, k)."""
        return np.asarray(self._features(points) @ self.weights[draw].T)

    def _features(self, points: Array) -> Array:
        x = self.points.of(points)
        return np.concatenate([np.ones((len(x), 1)), x, self.kernel(x)], axis=1)
