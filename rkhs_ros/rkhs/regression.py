"""Ridge regression, through the features or through their Gram matrix, whichever is smaller."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from rkhs_ros.rkhs.kernels import Array

BLOCK_ROWS = 20_000  # more than the steps of an iteration usually are
MOST_IN_GRAM = 1000  # rows of the features whose Gram matrix is formed, where it is larger than need be
LEAST_DIAGONAL = 1e-200  # mean of a Gram matrix's diagonal; below it all features vanish, as far from every centre


def ridge_regression(features: Array, targets: Array, penalty: Array, weights: Array | None = None) -> Array:
    r"""Minimise :math:`\frac1n \sum_i q_i |\phi_i \theta - y_i|^2 + \sum_j \lambda_j |\theta_j|^2`.

    Args:
        features: rows phi, shape (n, p).
        targets: shape (n, k).
        penalty: lambda, shape (p,), positive.
        weights: q, shape (n,); all 1 where None.

    Returns:
        The coefficients theta, shape (p, k).
    """
    n, p = features.shape
    if p == 0:
        return np.empty((0, targets.shape[1]))
    if n < p:
        return _dual_ridge_regression(features, targets, penalty, np.ones(n) if weights is None else weights)
    weighted = features if weights is None else features * weights[:, None]
    normal = weighted.T @ features / n + np.diag(penalty)
    return np.asarray(cho_solve(cho_factor(normal, check_finite=False), weighted.T @ targets / n))


def ridge_regression_by_blocks(
    features: Callable[[slice], Array], targets: Array, penalty: Array, block_rows: int = BLOCK_ROWS
) -> Array:
    """Solve the same problem without weights, with no more rows in memory at once than a block has.

    Args:
        features: from a slice of the rows to these, shape (rows, p).
        targets: shape (n, k).
        penalty: lambda, shape (p,), positive.
        block_rows: rows of a block; where these are all, the coefficients are those of `ridge_regression` to the bit.
    """
    n = len(targets)
    if n <= block_rows:
        return ridge_regression(features(slice(0, n)), targets, penalty)
    normal, right = np.diag(n * penalty), np.zeros((len(penalty), targets.shape[1]))
    for block in blocks_of(n, block_rows):
        rows = features(block)
        normal += rows.T @ rows
        right += rows.T @ targets[block]
    return np.asarray(cho_solve(cho_factor(normal, check_finite=False), right))


def blocks_of(count: int, block_rows: int = BLOCK_ROWS) -> Iterator[slice]:
    """Walk through so many rows, by no more at once than a block has."""
    return (slice(start, min(start + block_rows, count)) for start in range(0, count, block_rows))


def by_blocks(rows: Callable[[slice], Array], count: int, block_rows: int = BLOCK_ROWS) -> Array:
    """Return so many rows, of which no more are made at once than a block has."""
    if count <= block_rows:
        return rows(slice(0, count))
    return np.concatenate([rows(block) for block in blocks_of(count, block_rows)])


def _dual_ridge_regression(features: Array, targets: Array, penalty: Array, weights: Array) -> Array:
    """Solve the same problem through the n x n Gram, where there are more features than rows."""
    root = np.sqrt(weights / len(features))[:, None]
    scaled = root * features / penalty
    gram = scaled @ (root * features).T + np.eye(len(features))
    return np.asarray(scaled.T @ cho_solve(cho_factor(gram, check_finite=False), root * targets))


def relative_ridge_regression(features: Array, targets: Array, ridge: float, *, intercept: bool = True) -> Array:
    r"""Return the coefficients of a ridge regression with an intercept b, shape (p,).

    .. math:: \theta = \Phi^\top M (y - b 1), \qquad M = (\Phi \Phi^\top + \lambda I)^{-1}, \qquad
        b = 1^\top M y / 1^\top M 1

    Args:
        features: Phi, shape (n, p).
        targets: y, shape (n,).
        ridge: lambda relative to the mean diagonal of the Gram matrix.
        intercept: whether there is one; else b = 0.
    """
    if len(features) > max(MOST_IN_GRAM, features.shape[1]):
        return _primal_regression(features, targets, ridge, intercept)
    gram = features @ features.T
    regular = gram + ridge * _scale(np.trace(gram) / len(gram)) * np.eye(len(gram))
    ones = np.ones(len(gram))
    inverse_ones, inverse_targets = np.linalg.solve(regular, np.stack([ones, targets], axis=1)).T
    b = (ones @ inverse_targets) / (ones @ inverse_ones) if intercept else 0.0
    return np.asarray(features.T @ (inverse_targets - b * inverse_ones))


def _primal_regression(features: Array, targets: Array, ridge: float, intercept: bool) -> Array:
    r"""Solve the same problem without the Gram.

    .. math:: \lambda M = I - \Phi (\Phi^\top \Phi + \lambda I)^{-1} \Phi^\top
    """
    normal = features.T @ features
    regular = normal + ridge * _scale(np.trace(normal) / len(features)) * np.eye(len(normal))
    both = np.stack([np.ones(len(features)), targets], axis=1)
    coefficients = cho_solve(cho_factor(regular, check_finite=False), features.T @ both)
    of_ones, of_targets = np.sum(both - features @ coefficients, axis=0)
    b = of_targets / of_ones if intercept else 0.0
    return np.asarray(coefficients[:, 1] - b * coefficients[:, 0])


def _scale(diagonal: float) -> float:
    return diagonal if diagonal > LEAST_DIAGONAL else 1.0
