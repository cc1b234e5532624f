r"""Regression that knows what it does not know: a Gaussian process in a Newton basis.

The prior is a sum of a constant, a linear function and a function of an RKHS, in units in which points and targets
have mean 0 and standard deviation 1:

.. math:: y = f(x) + \epsilon, \qquad f \sim GP\big(0,\ s^2 (\kappa(x, x') + \tau^2 (1 + x \cdot x'))\big), \qquad
    \epsilon \sim N(0, \lambda s^2)

With all points as centres this is the Gaussian process itself; with m of them it costs O(n m^2) for n points.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from rkhs_ros.rkhs.kernels import RBF, Array, deviations, spreads
from rkhs_ros.rkhs.newton import NewtonBasis, pivoted_cholesky

LINEAR_SD = 3.0  # tau: of the linear part's coefficients, beside the kernel part's values
NOISES = np.geomspace(1e-8, 1.0, 25)  # lambda, of which the evidence chooses one for each target
BANDWIDTHS = (1.0, 1.6, 2.5, 4.0, 6.3)  # times root(d / 2), the scale of distances of points in d dimensions
NEWTON_TOLERANCE = 1e-8
LEAST_RESIDUAL = 1e-12  # part of the targets' square below which a residual is rounding
TINY = 1e-300


@dataclass(frozen=True)
class Units:
    """Mean and standard deviation of each column, by which they become comparable.

    Attributes:
        centre: shape (d,).
        scale: shape (d,), positive; 1 where a column is constant but for rounding.
    """

    centre: Array
    scale: Array

    @classmethod
    def of(cls, values: Array, weights: Array | None = None) -> Units:
        """Return the units of the columns of values, shape (n, d), n at least 1, each counted as often as it weighs."""
        return cls(np.average(values, axis=0, weights=weights), deviations(values, weights))

    def standardise(self, values: Array) -> Array:
        """Return values in these units."""
        return (values - self.centre) / self.scale

    def restore(self, values: Array) -> Array:
        """Return values that were in these units."""
        return values * self.scale + self.centre


class Coefficients(NamedTuple):
    """The posterior of the coefficients of k functions in p features, in the features' principal axes.

    Attributes:
        axes: orthonormal, shape (p, p).
        mean: of the coefficients, shape (p, k).
        sd: along each axis, shape (p, k).
        noise: standard deviation of the targets about the functions, shape (k,).
        signal: standard deviation s of the prior, shape (k,).
    """

    axes: Array
    mean: Array
    sd: Array
    noise: Array
    signal: Array


@dataclass(frozen=True)
class Posterior:
    """A distribution of functions from d to k dimensions, given values of them.

    Attributes:
        points: the units of points.
        targets: the units of values.
        basis: of the kernel part, on points in their units.
        coefficients: of the constant, the linear and the kernel part.
    """

    points: Units
    targets: Units
    basis: NewtonBasis
    coefficients: Coefficients

    @classmethod
    def fit(cls, points: Array, targets: Array, centres: int, weights: Array | None = None) -> Posterior:
        """Return the posterior with the bandwidth and the noises of the greatest evidence.

        Constant targets have no say in the bandwidth.

        Args:
            points: shape (n, d), n at least 1.
            targets: shape (n, k).
            centres: of the kernel part at most.
            weights: how often each point counts, shape (n,); once where None.
        """
        units, target_units = Units.of(points, weights), Units.of(targets, weights)
        x = units.standardise(points)
        y = np.where(spreads(targets, weights) > 0, target_units.standardise(targets), 0.0)
        root = np.ones(len(x)) if weights is None else np.sqrt(weights)
        fits = (_regress(basis, _features(x, values), y, root[:, None]) for basis, values in _bases(x, centres))
        best = max(fits, key=lambda fit: fit.evidence)
        return cls(units, target_units, best.basis, best.coefficients)

    def features(self, points: Array) -> Array:
        """Return constant, linear and kernel features at points of shape (n, d), shape (n, p)."""
        x = self.points.standardise(points)
        return _features(x, self.basis(x))

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
        return 1 + len(self.points.centre)

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
        points: the units of points.
        kernel: from points in their units to their kernel with m centres.
        weights: of 1, of points in their units and of the kernel, shape (rows, k, 1 + d + m).
    """

    points: Units
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
        x = self.points.standardise(points)
        return np.concatenate([np.ones((len(x), 1)), x, self.kernel(x)], axis=1)


def _features(x: Array, values: Array) -> Array:
    """Return constant, linear and kernel features of points, the last ones given."""
    return np.concatenate([LINEAR_SD * np.ones((len(x), 1)), LINEAR_SD * x, values], axis=1)


def _bases(x: Array, centres: int) -> Iterator[tuple[NewtonBasis, Array]]:
    """Yield a Newton basis for each bandwidth, and its values at the points."""
    for bandwidth in BANDWIDTHS:
        kernel = RBF((bandwidth * float(np.sqrt(x.shape[1] / 2.0)),))
        chosen = pivoted_cholesky(kernel, x, centres, NEWTON_TOLERANCE)
        yield NewtonBasis.of(kernel, x, chosen), chosen.values


class Fit(NamedTuple):
    """The regression in one basis.

    Attributes:
        basis: of the kernel part.
        evidence: logarithm of the targets' density, less a constant.
        coefficients: their posterior.
    """

    basis: NewtonBasis
    evidence: float
    coefficients: Coefficients


def _regress(basis: NewtonBasis, features: Array, targets: Array, roots: Array) -> Fit:
    r"""Return the posterior in a basis, with the noise of the greatest evidence for each target.

    With the eigenvalues e of :math:`\Phi^\top \Phi` and :math:`c = U^\top \Phi^\top y`,

    .. math:: q = y^\top (\Phi \Phi^\top + \lambda I)^{-1} y
            = \frac1\lambda \Big(y^\top y - \sum_i \frac{c_i^2}{e_i + \lambda}\Big), \qquad
        -2 \log p = n \log \frac{q}{n} + \sum_i \log(e_i + \lambda) + (n - p) \log \lambda

    at the best :math:`s^2 = q / n` (Rasmussen and Williams, 2006, Eq 5.8).

    Args:
        basis: of the kernel part.
        features: shape (points, p).
        targets: shape (points, k).
        roots: of how often each point counts, shape (points, 1); n is the sum of their squares.
    """
    features, targets = roots * features, roots * targets
    n, p = float(np.sum(roots**2)), features.shape[1]
    values, axes = np.linalg.eigh(features.T @ features)
    values = np.maximum(values, 0.0)[:, None]
    along = axes.T @ (features.T @ targets)
    squares = np.sum(targets**2, axis=0)
    evidences, signals = [], []
    for noise in NOISES:
        explained = np.sum(along**2 / (values + noise), axis=0)
        signal = np.maximum(squares - explained, LEAST_RESIDUAL * squares + TINY) / (noise * n)
        volume = np.sum(np.log(values + noise)) + (n - p) * np.log(noise)
        evidences.append(-0.5 * (n * np.log(signal) + volume))
        signals.append(signal)
    best = np.argmax(evidences, axis=0)
    columns = np.arange(targets.shape[1])
    noise, signal = NOISES[best], np.array(signals)[best, columns]
    sd = np.sqrt(signal * noise / (values + noise))
    mean = axes @ (along / (values + noise))
    total = float(np.array(evidences)[best, columns][squares > 0].sum())  # of targets that tell something
    return Fit(basis, total, Coefficients(axes, mean, sd, np.sqrt(signal * noise), np.sqrt(signal)))
