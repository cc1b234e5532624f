"""Functions of a vector-valued RKHS with kernel K = kappa I, and bases of fixed centres (Eq 3)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from math import isfinite

import numpy as np

from rkhs_ros.base.validation import finite_array, require
from rkhs_ros.rkhs.kernels import Array, Kernel, rowwise_matmul
from rkhs_ros.rkhs.regression import by_blocks

BLOCK_ROWS = 2000  # points evaluated at once; a block fits into the cache


@dataclass(frozen=True)
class Function:
    r"""A function :math:`h(x) = b + \sum_i \kappa(c_i, x) \alpha_i`, of the RKHS if b = 0 (Eq 7).

    Attributes:
        kernel: scalar kernel kappa.
        centres: points :math:`c_i`, shape (m, d); m = 0 gives a constant function.
        weights: vectors :math:`\alpha_i`, shape (m, n).
        bias: the constant b, n numbers, or none for 0.
    """

    kernel: Kernel
    centres: Array
    weights: Array
    bias: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        """Raise ValueError if the shapes do not match or a number is not finite."""
        for name in ("centres", "weights"):
            array = np.asarray(getattr(self, name))
            require(array.ndim == 2, name, "a matrix", f"shape {array.shape}")
            object.__setattr__(self, name, finite_array(array, array.shape, name))
        require(len(self.centres) == len(self.weights), "weights", f"{len(self.centres)} rows", len(self.weights))
        n = self.output_dim
        good = len(self.bias) in (0, n) and all(map(isfinite, self.bias))
        require(good, "bias", f"{n} finite numbers or none", self.bias)

    @classmethod
    def constant(cls, kernel: Kernel, input_dim: int, output_dim: int, bias: tuple[float, ...] = ()) -> Function:
        """Return a constant function from ``input_dim`` to ``output_dim`` dimensions."""
        return cls(kernel, np.zeros((0, input_dim)), np.zeros((0, output_dim)), bias)

    @property
    def input_dim(self) -> int:
        """Dimension of the points."""
        return int(self.centres.shape[1])

    @property
    def output_dim(self) -> int:
        """Dimension of the values."""
        return int(self.weights.shape[1])

    def __call__(self, x: Array) -> Array:
        """Evaluate at points of shape (batch, d): shape (batch, n); each row depends only on its own point."""
        if x.shape[1] != self.input_dim:
            raise ValueError(f"points: expected {self.input_dim} columns, got {x.shape[1]}")
        return self.prepared()(x)

    def prepared(self) -> Callable[[Array], Array]:
        """Return a bit-identical function that is faster for many calls and does not check the points' shape."""
        near, bias = self.kernel.to(self.centres), np.array(self.bias or 0.0)
        return lambda x: by_blocks(lambda rows: rowwise_matmul(near(x[rows]), self.weights) + bias, len(x), BLOCK_ROWS)

    def __add__(self, other: Function) -> Function:
        """Add two functions of the same space; equal centres are shared, different ones concatenated."""
        require(self.kernel == other.kernel, "sum of functions", f"the kernel {self.kernel}", other.kernel)
        bias = tuple(a + b for a, b in zip(self.bias, other.bias, strict=False)) or self.bias or other.bias
        if np.array_equal(self.centres, other.centres):
            return Function(self.kernel, self.centres, self.weights + other.weights, bias)
        return Function(
            self.kernel,
            np.concatenate([self.centres, other.centres]),
            np.concatenate([self.weights, other.weights]),
            bias,
        )

    def scale(self, factor: float) -> Function:
        """Return the function multiplied by a number."""
        return Function(self.kernel, self.centres, factor * self.weights, tuple(factor * b for b in self.bias))


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
