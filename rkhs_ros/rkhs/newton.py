"""The Newton basis: an orthonormal basis of the span of a few kernel functions, by pivoted Cholesky."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.linalg import solve_triangular

from rkhs_ros.rkhs.function import Function
from rkhs_ros.rkhs.kernels import Array, Kernel


class PivotedCholesky(NamedTuple):
    """A partial factorisation kappa(points, points) ~ values values'.

    Attributes:
        pivots: indices of the chosen points, shape (r,).
        values: Newton basis functions at all points, shape (n, r).
        power: what is left of the diagonal, shape (n,).
    """

    pivots: np.ndarray
    values: Array
    power: Array


def pivoted_cholesky(kernel: Kernel, points: Array, rank: int, tolerance: float = 1e-10) -> PivotedCholesky:
    r"""Choose points one by one where the power function is largest.

    The Gram matrix is never formed: O(n rank^2) time and O(n rank) memory.

    Args:
        kernel: kernel of the space.
        points: candidates, shape (n, d).
        rank: number of points at most.
        tolerance: stop where the power function is below this part of the largest :math:`\kappa(x, x)`.
    """
    power = kernel.diagonal(points)
    floor = tolerance * float(power.max(initial=0.0))
    rank = min(rank, len(points))
    rows = np.empty((rank, len(points)))
    pivots: list[int] = []
    for k in range(rank):
        pivot = int(power.argmax())
        if power[pivot] <= floor:
            break
        column = kernel(points, points[pivot : pivot + 1])[:, 0]
        column -= rows[:k, pivot] @ rows[:k]
        column /= np.sqrt(power[pivot])
        column[pivots] = 0.0
        rows[k] = column
        power = np.maximum(power - column**2, 0.0)
        pivots.append(pivot)
        power[pivots] = 0.0
    return PivotedCholesky(np.array(pivots, dtype=int), rows[: len(pivots)].T, power)


@dataclass(frozen=True)
class NewtonBasis:
    """Functions orthonormal in the RKHS that span the kernel functions of the centres.

    Attributes:
        kernel: kernel of the space.
        centres: shape (m, d).
        factor: lower triangular Cholesky factor of kappa(centres, centres), shape (m, m).
    """

    kernel: Kernel
    centres: Array
    factor: Array

    @classmethod
    def of(cls, kernel: Kernel, points: Array, chosen: PivotedCholesky) -> NewtonBasis:
        """Return the basis of the chosen points."""
        return cls(kernel, points[chosen.pivots], np.tril(chosen.values[chosen.pivots]))

    def __call__(self, x: Array) -> Array:
        """Evaluate the basis at points of shape (n, d): shape (n, m)."""
        values = solve_triangular(self.factor, self.kernel(self.centres, x), lower=True, check_finite=False)
        return np.asarray(values.T)

    def function(self, coefficients: Array) -> Function:
        """Return the function with those coefficients, shape (m, n), as centres and weights."""
        weights = solve_triangular(self.factor, coefficients, lower=True, trans="T", check_finite=False)
        return Function(self.kernel, self.centres, weights)
