r"""Coordinates in which functions change as fast in every direction.

What a function does not change along should not keep points apart. The outer products of the gradients of a first fit
tell where it does change, and become the squared distances of the next one (Radhakrishnan, Beaglehole, Pandit and
Belkin, 2024, "Mechanism for feature learning in neural networks and backpropagation-free machine learning models",
Science 383):

.. math:: L L^\top \propto \sum_{i, k} \nabla f_k(x_i)\, \nabla f_k(x_i)^\top
"""

from __future__ import annotations

import numpy as np

from rkhs_ros.rkhs.evidence import LINEAR_SD, Fit, best_fit
from rkhs_ros.rkhs.kernels import Array, evenly
from rkhs_ros.rkhs.standardizer import Coordinates

MOST_FITTED, MOST_SLOPES = 1000, 300  # points that are enough
ROUNDS = 3  # of stretching, as long as the evidence grows


def fit_metric(
    plain: Coordinates, points: Array, targets: Array, roots: Array, centres: int
) -> tuple[Coordinates, Fit]:
    """Return the coordinates whose evidence is greatest, of those without axes and some with stretched ones, and a fit.

    The coordinates are chosen by some of the points, where there are many; the fit is that to all of them.

    Args:
        plain: without axes.
        points: shape (n, d).
        targets: values of the functions in units, shape (n, k).
        roots: of how often each point counts, shape (n, 1).
        centres: of the fit at most.
    """
    some, their_targets, their_roots = (evenly(each, MOST_FITTED) for each in (points, targets, roots))
    best, fit = _refine_metric(plain, some, their_targets, their_roots, centres)
    if len(points) > MOST_FITTED:
        fit = best_fit(best.of(points), targets, roots, centres)
    return best, fit


def _refine_metric(
    plain: Coordinates, points: Array, targets: Array, roots: Array, centres: int
) -> tuple[Coordinates, Fit]:
    best, fit = plain, best_fit(plain.of(points), targets, roots, centres)
    for _ in range(ROUNDS):
        axes = _axes(best, fit, points, roots)
        if axes is None:
            break
        tried = Coordinates(plain.units, axes)
        its_fit = best_fit(tried.of(points), targets, roots, centres)
        if its_fit.evidence <= fit.evidence:
            break
        best, fit = tried, its_fit
    return best, fit


def _axes(coordinates: Coordinates, fit: Fit, points: Array, roots: Array) -> Array | None:
    """Return L of the fit's gradients, shape (d, d); None where the functions do not change."""
    gradients = slopes(fit, coordinates.of(evenly(points, MOST_SLOPES))) * evenly(roots, MOST_SLOPES)[:, :, None]
    if coordinates.axes is not None:
        gradients = np.einsum("de,nek->ndk", coordinates.axes, gradients)
    squares, axes = np.linalg.eigh(np.einsum("ndk,nek->de", gradients, gradients))
    squares = np.maximum(squares, 0.0)
    total = squares.sum()
    return axes * np.sqrt(squares * len(axes) / total) if total > 0 else None


def slopes(fit: Fit, x: Array) -> Array:
    """Return the gradients of the expected functions at points of shape (n, d), shape (n, d, k)."""
    mean, d, centres = fit.coefficients.mean, x.shape[1], fit.basis.centres
    weights = fit.basis.weights(mean[1 + d :])
    values = fit.basis.kernel(x, centres)
    towards = np.einsum("nm,mk,md->ndk", values, weights, centres, optimize=True)
    curved = (towards - x[:, :, None] * (values @ weights)[:, None]) / fit.bandwidth**2
    return np.asarray(LINEAR_SD * mean[1 : 1 + d] + curved)
