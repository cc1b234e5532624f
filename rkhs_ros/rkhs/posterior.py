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
from dataclasses import dataclass, replace
from functools import cached_property, partial

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_solve
from scipy.special import ndtri

from rkhs_ros.base.endings import deferred_signals
from rkhs_ros.rkhs.evidence import LINEAR_SD, SMOOTH, Fit, Hyperprior, best_fit, features_of
from rkhs_ros.rkhs.kernels import Array, rowwise_matmul, spreads
from rkhs_ros.rkhs.metric_learning import Coordinates, Standardizer, fit_metric

WAVES = 128  # frequencies that represent the prior outside the span of the centres; a power of 2


@dataclass(frozen=True)
class Posterior(Fit):
    """The posterior distribution of functions from d to k dimensions.

    Attributes:
        points: maps points to coordinates.
        targets: standardises the targets.
    """

    points: Coordinates
    targets: Standardizer

    @classmethod
    def fit(
        cls,
        points: Array,
        targets: Array,
        centres: int,
        weights: Array | None = None,
        *,
        centred: bool = False,
        hyperprior: Hyperprior = SMOOTH,
    ) -> Posterior:
        """Fit the posterior with the coordinates, the bandwidth and the noises of the greatest evidence.

        Constant targets do not affect the bandwidth.

        Args:
            points: shape (n, d), n at least 1.
            targets: shape (n, k).
            centres: maximum number of centres of the kernel part.
            weights: weight of each point, shape (n,); None for 1.
            centred: also try the centred metric; see `rkhs_ros.rkhs.metric_learning`.
            hyperprior: hyper-parameters that are possible.
        """
        units, of_targets = Standardizer.of(points, weights), Standardizer.of(targets, weights)
        y = np.where(spreads(targets, weights) > 0, of_targets.standardise(targets), 0.0)
        roots = np.ones((len(points), 1)) if weights is None else np.sqrt(weights)[:, None]
        regress = partial(best_fit, centres=centres, bounded=hyperprior.bounded)
        of_metric = partial(regress, bandwidths=hyperprior.metric_bandwidths)
        alike = hyperprior.bandwidths == hyperprior.metric_bandwidths
        final = None if alike else partial(regress, bandwidths=hyperprior.bandwidths)
        coordinates, best = fit_metric(Coordinates(units), points, y, roots, of_metric, final, centred=centred)
        return cls(**vars(best), points=coordinates, targets=of_targets)

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

    @property
    def draw_shape(self) -> tuple[int, int]:
        """Shape (k, p + 2 `WAVES`) of the standard normal numbers of a draw."""
        features, outputs = self.coefficients.mean.shape
        return outputs, features + 2 * WAVES

    def draw(self, normals: Array) -> DrawnFunctions:
        r"""Return functions drawn from the posterior.

        Outside the span of the centres the posterior is the prior. Its part there is a sum of waves less the kernel
        functions that interpolate it at the centres C (pathwise conditioning, Wilson et al., 2021, Eq 12):

        .. math:: f(x) = f_C(x) + s\big(\phi(x) - \kappa(x, C) \kappa(C, C)^{-1} \phi(C)\big) \cdot \epsilon,
            \qquad \phi(x) = (\cos x \Omega, \sin x \Omega) / \sqrt{F}

        All draws have the same F frequencies (Rahimi and Recht, 2007) and weights of their own.

        Args:
            normals: standard normal numbers, shape (draws, `draw_shape`).
        """
        inside, outside = np.split(normals, [len(self.coefficients.mean)], axis=2)
        waves = outside * self.coefficients.signal[:, None]
        kernel = -np.matmul(waves, self._interpolation.T)
        weights = self._weights(inside)
        weights[:, :, self.linear_size :] += kernel * self.targets.scale[:, None]
        weights = np.concatenate([weights, waves * self.targets.scale[:, None]], axis=2)
        return DrawnFunctions(self.points, self._kernel, weights, self._frequencies)

    def expected(self) -> DrawnFunctions:
        """Return the posterior mean as a single draw."""
        weights = self._weights(np.zeros((1, *self.coefficients.mean.T.shape)))
        return DrawnFunctions(self.points, self._kernel, weights, np.empty((self.points.dimension, 0)))

    def _weights(self, normals: Array) -> Array:
        """Return the weights of 1, x and the kernel functions of draws inside the span, shape (draws, k, p)."""
        axes, mean, sd, _, _ = self.coefficients
        weights = np.matmul((axes.T @ mean).T + sd.T * normals, self._directions.T) * self.targets.scale[:, None]
        weights[:, :, 0] += self.targets.centre
        return np.asarray(weights)

    @property  # not stored, since functions of kernels cannot be pickled
    def _kernel(self) -> Callable[[Array], Array]:
        return self.basis.kernel.with_centres(self.basis.centres)

    @cached_property
    def _frequencies(self) -> Array:
        """Frequencies of the kernel's spectral density, shape (d, F).

        A low-discrepancy sequence represents the kernel better than random numbers, of which the interpolation between
        centres magnifies the errors.
        """
        return np.asarray(ndtri(spread_points(WAVES, self.points.dimension, seed=0)).T / self.bandwidth)

    @cached_property
    def _interpolation(self) -> Array:
        """Weights of the kernel functions that interpolate each wave at the centres, shape (m, 2 F)."""
        values = _waves(self.basis.centres, self._frequencies).astype(float)
        return np.asarray(cho_solve((self.basis.factor, True), values)) if len(values) else values

    @cached_property
    def _directions(self) -> Array:
        """The coefficients' axes as weights of 1, x and the kernel functions, one axis per column, shape (p, p)."""
        linear, kernel = np.split(self.coefficients.axes, [self.linear_size])
        return np.concatenate([LINEAR_SD * linear, self.basis.weights(kernel)])


def spread_points(count: int, dimension: int, seed: int) -> Array:
    """Return points of a Sobol sequence in the unit cube, shape (count, dimension)."""
    with deferred_signals():  # SciPy loses an exception that a handler raises while it reads the direction numbers
        from scipy.stats.qmc import Sobol  # here, since the import takes half a second

        return np.asarray(Sobol(dimension, seed=seed).random(count))


@dataclass(frozen=True)
class DrawnFunctions:
    """Functions drawn from a posterior: each draw consists of k functions. A single draw has values at any points.

    Attributes:
        points: maps points to coordinates.
        kernel: maps coordinates to their kernel with m centres.
        weights: weights of 1, the coordinates, the kernel and the waves, shape (draws, k, 1 + d + m + 2 F).
        frequencies: frequencies of the waves, shape (d, F).
    """

    points: Coordinates
    kernel: Callable[[Array], Array]
    weights: Array
    frequencies: Array

    def __call__(self, points: Array) -> Array:
        """Evaluate each draw at its own point, points of shape (draws, d): shape (draws, k).

        The values at a point do not depend on the others; this holds bit-identically.
        """
        return np.asarray(np.matmul(self.weights, self._features(points)[:, :, None])[:, :, 0])

    def take(self, draws: NDArray[np.int_]) -> DrawnFunctions:
        """Return the draws with the given numbers."""
        return replace(self, weights=self.weights[draws])

    def along(self, paths: Array) -> Array:
        """Evaluate each draw at the points of its own path or of the only one, shape (draws or 1, n, d): (draws, n, k).

        The values on a path do not depend on the other paths; this holds bit-identically.
        """
        features = self._features(paths.reshape(-1, paths.shape[2]))
        return np.asarray(np.matmul(features.reshape(*paths.shape[:2], -1), self.weights.swapaxes(1, 2)))

    def _features(self, points: Array) -> Array:
        x = self.points.of(points)
        return np.concatenate([np.ones((len(x), 1)), x, self.kernel(x), _waves(x, self.frequencies)], axis=1)


def _waves(x: Array, frequencies: Array) -> Array:
    """Return Fourier features of coordinates, shape (n, 2 F); each row depends only on itself."""
    phases = rowwise_matmul(x, frequencies).astype(np.float32)  # six times faster, as accurate as waves need to be
    return np.concatenate([np.cos(phases), np.sin(phases)], axis=1) / np.float32(np.sqrt(max(phases.shape[1], 1)))
