"""Functions of a vector-valued RKHS with kernel K = kappa I."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from rkhs_ros.base.validation import finite_array, require
from rkhs_ros.rkhs.kernels import Array, Kernel, rowwise_matmul
from rkhs_ros.rkhs.regression import by_blocks

BLOCK_ROWS = 2000  # points evaluated at once; a block fits into the cache


@dataclass(frozen=True)
class Function:
    r"""A function :math:`h(x) = \sum_i \kappa(c_i, x) \alpha_i` (Eq 7).

    Attributes:
        kernel: scalar kernel kappa.
        centres: points :math:`c_i`, shape (m, d); m = 0 gives the zero function.
        weights: vectors :math:`\alpha_i`, shape (m, n).
    """

    kernel: Kernel
    centres: Array
    weights: Array

    def __post_init__(self) -> None:
        """Raise ValueError if the shapes do not match or a number is not finite."""
        for name in ("centres", "weights"):
            array = np.asarray(getattr(self, name))
            require(array.ndim == 2, name, "a matrix", f"shape {array.shape}")
            object.__setattr__(self, name, finite_array(array, array.shape, name))
        require(len(self.centres) == len(self.weights), "weights", f"{len(self.centres)} rows", len(self.weights))

    @classmethod
    def zero(cls, kernel: Kernel, input_dim: int, output_dim: int) -> Function:
        """Return the zero function from ``input_dim`` to ``output_dim`` dimensions."""
        return cls(kernel, np.zeros((0, input_dim)), np.zeros((0, output_dim)))

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
        near = self.kernel.to(self.centres)
        return lambda x: by_blocks(lambda rows: rowwise_matmul(near(x[rows]), self.weights), len(x), BLOCK_ROWS)

    def __add__(self, other: Function) -> Function:
        """Add two functions of the same space; equal centres are shared, different ones concatenated."""
        require(self.kernel == other.kernel, "sum of functions", f"the kernel {self.kernel}", other.kernel)
        if np.array_equal(self.centres, other.centres):
            return Function(self.kernel, self.centres, self.weights + other.weights)
        return Function(
            self.kernel,
            np.concatenate([self.centres, other.centres]),
            np.concatenate([self.weights, other.weights]),
        )

    def scale(self, factor: float) -> Function:
        """Return the function multiplied by a number."""
        return Function(self.kernel, self.centres, factor * self.weights)

    def inner(self, other: Function) -> float:
        r"""Return :math:`\langle h, g \rangle_{H_K} = \mathrm{tr}(\alpha^\top \kappa(c, c') \beta)`."""
        gram = self.kernel(self.centres, other.centres)
        return float(np.sum(self.weights * (gram @ other.weights)))

    def norm(self) -> float:
        """Return the norm in the RKHS."""
        return float(np.sqrt(max(self.inner(self), 0.0)))
