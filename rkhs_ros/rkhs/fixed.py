"""Fixed centres: kernel functions of given points as the features of a parametric function (Eq 3)."""

from dataclasses import dataclass

import numpy as np

from rkhs_ros.rkhs.function import Function
from rkhs_ros.rkhs.kernels import Array, Kernel


@dataclass(frozen=True)
class FixedBasis:
    """The basis of the centres' kernel functions; the coefficients of a function are its weights.

    Attributes:
        kernel: kernel of the space.
        centres: shape (m, d).
    """

    kernel: Kernel
    centres: Array

    def __call__(self, x: Array) -> Array:
        """Evaluate the basis at points of shape (n, d): shape (n, m)."""
        return self.kernel(x, self.centres)

    def function(self, coefficients: Array) -> Function:
        """Return the function with the given coefficients, shape (m, n)."""
        return Function(self.kernel, self.centres, coefficients)


def grid(low: Array, high: Array, counts: tuple[int, ...]) -> Array:
    """Return the points of a regular grid, including its borders, shape (product of counts, d).

    Args:
        low: lower corner, shape (d,).
        high: upper corner, shape (d,).
        counts: number of points along each dimension; a single point lies in the middle.
    """
    spans = zip(low, high, counts, strict=True)
    axes = [np.linspace(a, b, k) if k > 1 else np.array([0.5 * (a + b)]) for a, b, k in spans]
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, len(counts))
