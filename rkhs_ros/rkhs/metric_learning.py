r"""Learn coordinates in which functions change equally fast in every direction.

A direction along which the function is constant should not separate points. The outer products of the gradients of one
fit therefore define the squared distances of the next one (Radhakrishnan, Beaglehole, Pandit and Belkin, 2024,
"Mechanism for feature learning in neural networks and backpropagation-free machine learning models", Science 383):

.. math:: L L^\top \propto \sum_{i, k} \nabla f_k(x_i)\, \nabla f_k(x_i)^\top

The centred metric subtracts the mean gradient of each function :math:`f_k` first, because the linear part of a fit
explains a constant gradient.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from rkhs_ros.rkhs.evidence import LINEAR_SD, Fit
from rkhs_ros.rkhs.kernels import Array, deviations, rowwise_matmul, subsample


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


MOST_FITTED, MOST_SLOPES = 1000, 300  # maximum number of points for the selection, and for the gradients
Regression = Callable[[Array, Array, Array], Fit]  # of points, targets and the roots of the weights
ROUNDS = 3  # maximum number of updates of the metric; stops when the evidence no longer grows


def fit_metric(
    plain: Coordinates,
    points: Array,
    targets: Array,
    roots: Array,
    regress: Regression,
    final: Regression | None = None,
    *,
    centred: bool = False,
) -> tuple[Coordinates, Fit]:
    """Return the coordinates with the greatest evidence, plain or with a learnt metric, and a fit in them.

    If there are many points, a subset of them selects the coordinates; the fit uses all of them.

    Args:
        plain: coordinates without axes.
        points: shape (n, d).
        targets: standardised values of the functions, shape (n, k).
        roots: square roots of the points' weights, shape (n, 1).
        regress: fits the regression, see `best_fit`.
        final: fits it in the learnt coordinates; None for the same.
        centred: also try the centred metric, and return the one with the greater evidence.
    """
    some, their_targets, their_roots = (subsample(each, MOST_FITTED) for each in (points, targets, roots))
    first = regress(plain.of(some), their_targets, their_roots)
    tried = [
        _refine_metric(plain, first, some, their_targets, their_roots, regress, centred=each)
        for each in ((False, True) if centred else (False,))
    ]
    best, fit = max(tried, key=lambda pair: pair[1].evidence)
    if final is not None or len(points) > MOST_FITTED:
        fit = (final or regress)(best.of(points), targets, roots)
    return best, fit


def _refine_metric(
    plain: Coordinates, first: Fit, points: Array, targets: Array, roots: Array, regress: Regression, *, centred: bool
) -> tuple[Coordinates, Fit]:
    best, fit = plain, first
    for _ in range(ROUNDS):
        axes = _axes(best, fit, points, roots, centred=centred)
        if axes is None:
            break
        tried = Coordinates(plain.units, axes)
        its_fit = regress(tried.of(points), targets, roots)
        if its_fit.evidence <= fit.evidence:
            break
        best, fit = tried, its_fit
    return best, fit


def _axes(coordinates: Coordinates, fit: Fit, points: Array, roots: Array, *, centred: bool) -> Array | None:
    """Return L of the fit's gradients, shape (d, d); None if the functions are constant."""
    gradients, roots = slopes(fit, coordinates.of(subsample(points, MOST_SLOPES))), subsample(roots, MOST_SLOPES)
    if centred:
        gradients -= np.average(gradients, axis=0, weights=roots[:, 0] ** 2)
    gradients *= roots[:, :, None]
    if coordinates.axes is not None:
        gradients = np.einsum("de,nek->ndk", coordinates.axes, gradients)
    squares, axes = np.linalg.eigh(np.einsum("ndk,nek->de", gradients, gradients))
    squares = np.maximum(squares, 0.0)
    total = squares.sum()
    return axes * np.sqrt(squares * len(axes) / total) if total > 0 else None


def slopes(fit: Fit, x: Array) -> Array:
    """Return the gradients of the mean functions at points of shape (n, d): shape (n, d, k)."""
    mean, d, centres = fit.coefficients.mean, x.shape[1], fit.basis.centres
    weights = fit.basis.weights(mean[1 + d :])
    values = fit.basis.kernel(x, centres)
    towards = np.einsum("nm,mk,md->ndk", values, weights, centres, optimize=True)
    curved = (towards - x[:, :, None] * (values @ weights)[:, None]) / fit.bandwidth**2
    return np.asarray(LINEAR_SD * mean[1 : 1 + d] + curved)
