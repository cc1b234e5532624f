"""The Newton basis: an orthonormal basis of the span of a few kernel functions, from pivoted Cholesky."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.linalg import solve_triangular
from scipy.linalg.blas import dtrsm

from rkhs_ros.rkhs.function import Function
from rkhs_ros.rkhs.kernels import Array, Kernel
from rkhs_ros.rkhs.regression import blocks_of


class PivotedCholesky(NamedTuple):
    """A partial factorisation kappa(points, points) ~ values values'.

    Attributes:
        pivots: indices of the selected points, shape (r,).
        values: Newton basis functions at all points, shape (n, r).
        power: remaining diagonal, the squared power function, shape (n,).
        floor: power up to which the basis functions span a point's kernel function.
    """

    pivots: np.ndarray
    values: Array
    power: Array
    floor: float


def pivoted_cholesky(kernel: Kernel, points: Array, rank: int, tolerance: float = 1e-10) -> PivotedCholesky:
    r"""Select points greedily by the largest power function.

    Takes O(n rank^2) time and O(n rank) memory: the Gram matrix is formed only if all points may be selected, so that
    it is no larger than the result.

    Args:
        kernel: kernel of the space.
        points: candidates, shape (n, d).
        rank: maximum number of selected points.
        tolerance: stop when the largest power is below this fraction of the largest :math:`\kappa(x, x)`.
    """
    power = np.array(kernel.diagonal(points))
    floor = tolerance * float(power.max(initial=0.0))
    rank = min(rank, len(points))
    rows = np.empty((rank, len(points)))
    pivots = np.empty(rank, dtype=int)
    gram = kernel(points, points) if rank == len(points) else None
    near = kernel.to(points)
    for k in range(rank):
        pivot = int(power.argmax())
        if power[pivot] <= floor:
            pivots, rows = pivots[:k], rows[:k]
            break
        rows[k] = near(points[pivot : pivot + 1])[0] if gram is None else gram[pivot]
        shares, length = rows[:k, pivot], np.sqrt(power[pivot])
        for block in blocks_of(len(points)):  # a block fits into the cache
            row = rows[k, block]
            row -= shares @ rows[:k, block]
            row /= length
            power[block] = np.maximum(power[block] - row**2, 0.0)
        rows[k, pivots[:k]], power[pivot], pivots[k] = 0.0, 0.0, pivot
    return PivotedCholesky(pivots, rows.T, power, floor)


@dataclass(frozen=True)
class NewtonBasis:
    """Functions that are orthonormal in the RKHS and span the kernel functions of the centres.

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
        """Return the basis of the selected points."""
        return cls(kernel, points[chosen.pivots], np.tril(chosen.values[chosen.pivots]))

    def __call__(self, x: Array) -> Array:
        """Evaluate the basis at points of shape (n, d): shape (n, m)."""
        if len(self.centres) == 0:
            return np.empty((len(x), 0))
        # Solves values factor' = kappa(x, centres). Solving from the right is twice as fast as solve_triangular.
        return np.asarray(dtrsm(1.0, self.factor.T, self.kernel(self.centres, x).T, side=1))

    def function(self, coefficients: Array) -> Function:
        """Return the function with the given coefficients, shape (m, n), as centres and weights."""
        return Function(self.kernel, self.centres, self.weights(coefficients))

    def weights(self, coefficients: Array) -> Array:
        """Return the weights of the centres' kernel functions for given coefficients, both of shape (m, n)."""
        if len(self.centres) == 0:
            return np.empty((0, coefficients.shape[1]))
        return np.asarray(solve_triangular(self.factor, coefficients, lower=True, trans="T", check_finite=False))
