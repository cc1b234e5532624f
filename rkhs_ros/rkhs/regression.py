"""Ridge regression in its primal or dual form, whichever has the smaller matrix."""

from collections.abc import Callable, Iterator

import numpy as np
from scipy.linalg import LinAlgError, cho_factor, cho_solve

from rkhs_ros.rkhs.kernels import Array, spreads

BLOCK_ROWS = 20_000  # more than the usual number of steps in an iteration
LEAST_DIAGONAL = 1e-200  # mean diagonal of a Gram matrix below which all features vanish, e.g. far from every centre


def ridge_regression(features: Array, targets: Array, penalty: Array, weights: Array | None = None) -> Array:
    r"""Minimise :math:`\frac1n \sum_i q_i |\phi_i \theta - y_i|^2 + \sum_j \lambda_j |\theta_j|^2`.

    Args:
        features: phi, one row per sample, shape (n, p).
        targets: y, shape (n, k).
        penalty: lambda, shape (p,), positive.
        weights: q, shape (n,); None for 1.

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
    return np.asarray(_solved(normal, weighted.T @ targets / n))


def _solved(matrix: Array, right: Array) -> Array:
    """Solve a system with a positive definite matrix; use the least norm if rounding errors exceed the penalty."""
    try:
        return np.asarray(cho_solve(cho_factor(matrix, check_finite=False), right))
    except LinAlgError:
        return np.asarray(np.linalg.lstsq(matrix, right, rcond=None)[0])


def blocks_of(count: int, block_rows: int = BLOCK_ROWS) -> Iterator[slice]:
    """Yield slices of at most ``block_rows`` rows that cover ``count`` rows."""
    return (slice(start, min(start + block_rows, count)) for start in range(0, count, block_rows))


def by_blocks(rows: Callable[[slice], Array], count: int, block_rows: int = BLOCK_ROWS) -> Array:
    """Compute ``count`` rows in blocks of at most ``block_rows`` and return them together."""
    if count <= block_rows:
        return rows(slice(0, count))
    return np.concatenate([rows(block) for block in blocks_of(count, block_rows)])


def _dual_ridge_regression(features: Array, targets: Array, penalty: Array, weights: Array) -> Array:
    """Solve the dual problem with the n x n Gram matrix, for more features than rows."""
    root = np.sqrt(weights / len(features))[:, None]
    scaled = root * features / penalty
    gram = scaled @ (root * features).T + np.eye(len(features))
    return np.asarray(scaled.T @ _solved(gram, root * targets))


def relative_ridge_regression(features: Array, targets: Array, ridge: float, *, intercept: bool = True) -> Array:
    r"""Return the coefficients of a ridge regression with an intercept b, shape (p,).

    .. math:: \theta = \Phi^\top M (y - b 1), \qquad M = (\Phi \Phi^\top + \lambda I)^{-1}, \qquad
        b = 1^\top M y / 1^\top M 1

    Args:
        features: Phi, shape (n, p).
        targets: y, shape (n,).
        ridge: lambda relative to the mean diagonal of the Gram matrix.
        intercept: whether to fit b; otherwise b = 0.
    """
    if intercept and spreads(targets[:, None])[0] == 0.0:
        return np.zeros(features.shape[1])  # exactly, since a step size may magnify rounding errors
    gram = features @ features.T
    diagonal = np.trace(gram) / len(gram)
    regular = gram + ridge * (diagonal if diagonal > LEAST_DIAGONAL else 1.0) * np.eye(len(gram))
    ones = np.ones(len(gram))
    inverse_ones, inverse_targets = np.linalg.solve(regular, np.stack([ones, targets], axis=1)).T
    b = (ones @ inverse_targets) / (ones @ inverse_ones) if intercept else 0.0
    return np.asarray(features.T @ (inverse_targets - b * inverse_ones))
