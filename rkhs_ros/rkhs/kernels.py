"""Kernels: the fields of a kernel are its hyper-parameters, and kernels compose with ``+`` and ``*``.

Files and messages store a kernel as its terms in postfix order: leaves have a name and parameters; ``sum`` and
``product`` combine the two kernels before them.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import ClassVar, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.distance import cdist, pdist

from rkhs_ros.base.validation import NamedFields, numbers, pick, require

Array = NDArray[np.float64]
MAX_KERNEL_TERMS = 100  # evaluation recurses into nested terms
ROUNDING = 1e-9  # relative to a column's largest magnitude; smaller variation is rounding error


class Term(NamedTuple):
    """One entry of a kernel in postfix order."""

    name: str
    parameters: tuple[float, ...]


class Kernel(NamedFields, ABC):
    """A positive semi-definite function of two points that is evaluated on all pairs of two sets.

    Example::

        kernel = RBF((0.5, 2.0)) + Polynomial(offset=1.0, degree=2)
        gram = kernel(x, y)  # shape (n, m)
    """

    @abstractmethod
    def __call__(self, x: Array, y: Array) -> Array:
        """Evaluate the kernel on all pairs.

        Each row of the result depends only on that row of ``x`` and on ``y``; this holds bit-identically.

        Args:
            x: points, shape (n, d).
            y: points, shape (m, d).

        Returns:
            The matrix of kernel values, shape (n, m).
        """

    @abstractmethod
    def diagonal(self, x: Array) -> Array:
        """Return the kernel of each point of ``x``, shape (n, d), with itself: shape (n,)."""

    def to(self, y: Array) -> Callable[[Array], Array]:
        """Return a function from points to their kernel with ``y``: faster for many calls, bit-identical."""
        return lambda x: self(x, y)

    def with_centres(self, centres: Array) -> Callable[[Array], Array]:
        """Return a fast function from points to their kernel with centres, shape (m, d).

        Its values equal the kernel's up to rounding. Each row depends only on its own point, bit-identically.
        """
        return lambda x: self(x, centres)

    @property
    def is_positive(self) -> bool:
        """Whether all values are non-negative and can thus be weights of a mean; False by default."""
        return False

    @abstractmethod
    def terms(self) -> tuple[Term, ...]:
        """Return the kernel's terms in postfix order; the inverse of `kernel_from_terms`."""

    def __add__(self, other: Kernel) -> Sum:
        return Sum(self, other)

    def __mul__(self, other: Kernel) -> Product:
        return Product(self, other)


@dataclass(frozen=True)
class RBF(Kernel):
    r"""Squared exponential kernel with one bandwidth per dimension, or one for all.

    .. math:: \kappa(x, y) = \exp(-\tfrac12 \textstyle\sum_j (x_j - y_j)^2 / b_j^2)
    """

    bandwidth: tuple[float, ...]

    def __post_init__(self) -> None:
        """Raise ValueError if a bandwidth is not a positive finite number."""
        values = np.atleast_1d(np.asarray(self.bandwidth, dtype=float))
        good = values.ndim == 1 and len(values) > 0 and np.all((values > 0) & np.isfinite(values))
        require(bool(good), "rbf bandwidth", "positive finite numbers, one or one per dimension", self.bandwidth)
        object.__setattr__(self, "bandwidth", tuple(values.tolist()))

    def __call__(self, x: Array, y: Array) -> Array:  # noqa: D102
        return self.to(y)(x)

    def to(self, y: Array) -> Callable[[Array], Array]:  # noqa: D102
        scale = self._scale(y.shape[1])
        scaled = y * scale
        return lambda x: _gaussian(x * scale, scaled)

    def with_centres(self, centres: Array) -> Callable[[Array], Array]:
        r"""See `Kernel.with_centres`.

        With points relative to the mean of the centres, in bandwidths, one matrix product replaces all differences:

        .. math:: \kappa(x, c) = \exp\big((1, x, x \cdot x) \cdot (-c \cdot c / 2, c, -1/2)\big)
        """
        scale, origin = self._scale(centres.shape[1]), centres.mean(axis=0)
        c = (centres - origin) * scale
        factors = np.vstack([-0.5 * np.einsum("ij,ij->i", c, c), c.T, np.full(len(c), -0.5)])

        def evaluate(points: Array) -> Array:
            terms = np.empty((len(points), len(factors)))
            x = np.multiply(points - origin, scale, out=terms[:, 1:-1])
            terms[:, 0], terms[:, -1] = 1.0, np.einsum("ij,ij->i", x, x)
            exponents = rowwise_matmul(terms, factors)
            return np.asarray(np.exp(exponents, out=exponents))

        return evaluate

    def _scale(self, d: int) -> Array:
        if len(self.bandwidth) not in (1, d):
            expected = f"{numbers(1, d)} for {d}-dimensional points"
            raise ValueError(f"rbf bandwidth: expected {expected}, got {len(self.bandwidth)}")
        return 1.0 / np.array(self.bandwidth)

    def diagonal(self, x: Array) -> Array:  # noqa: D102
        return np.ones(len(x))

    @property
    def is_positive(self) -> bool:  # noqa: D102
        return True

    def terms(self) -> tuple[Term, ...]:  # noqa: D102
        return (Term("rbf", self.bandwidth),)


@dataclass(frozen=True)
class Polynomial(Kernel):
    r"""Polynomial kernel :math:`\kappa(x, y) = (x \cdot y + c)^p`."""

    offset: float
    degree: int

    def __post_init__(self) -> None:
        """Raise ValueError if the offset is negative or the degree is not a whole number from 1 to 20."""
        require(np.isfinite(self.offset) and self.offset >= 0, "polynomial offset", "a number >= 0", self.offset)
        whole = np.isfinite(self.degree) and self.degree == int(self.degree) and 1 <= self.degree <= 20
        require(bool(whole), "polynomial degree", "a whole number from 1 to 20", self.degree)
        object.__setattr__(self, "degree", int(self.degree))

    def __call__(self, x: Array, y: Array) -> Array:  # noqa: D102
        return np.asarray((rowwise_matmul(x, y.T) + self.offset) ** self.degree)

    def diagonal(self, x: Array) -> Array:  # noqa: D102
        return np.asarray((np.einsum("ij,ij->i", x, x) + self.offset) ** self.degree)

    @property
    def is_positive(self) -> bool:  # noqa: D102
        return self.degree % 2 == 0

    def terms(self) -> tuple[Term, ...]:  # noqa: D102
        return (Term("polynomial", (float(self.offset), float(self.degree))),)


LINEAR = Polynomial(0.0, 1)


@dataclass(frozen=True)
class Linear(Kernel):
    r"""Linear kernel about a centre, with one scale per dimension.

    .. math:: \kappa(x, y) = 1 + \textstyle\sum_j (x_j - o_j)(y_j - o_j) / b_j^2
    """

    centre: tuple[float, ...]
    scale: tuple[float, ...]

    def __post_init__(self) -> None:
        """Raise ValueError if a number is not finite, a scale is not positive, or the lengths differ."""
        for name in ("centre", "scale"):
            object.__setattr__(self, name, tuple(np.asarray(getattr(self, name), dtype=float).tolist()))
        good = len(self.centre) == len(self.scale) > 0 and all(np.isfinite([*self.centre, *self.scale]))
        require(
            good and min(self.scale) > 0,
            "linear scale",
            "positive finite numbers, one per coordinate of the centre",
            self.scale,
        )

    def __call__(self, x: Array, y: Array) -> Array:  # noqa: D102
        return 1.0 + rowwise_matmul(self._standardise(x), self._standardise(y).T)

    def diagonal(self, x: Array) -> Array:  # noqa: D102
        z = self._standardise(x)
        return np.asarray(1.0 + np.einsum("ij,ij->i", z, z))

    def _standardise(self, x: Array) -> Array:
        require(x.shape[1] == len(self.centre), "linear points", f"{len(self.centre)} columns", x.shape[1])
        return np.asarray((x - np.array(self.centre)) / np.array(self.scale))

    def terms(self) -> tuple[Term, ...]:  # noqa: D102
        return (Term("linear", (*self.centre, *self.scale)),)


@dataclass(frozen=True)
class Pair(Kernel):
    """Two kernels, whose values an operation combines."""

    left: Kernel
    right: Kernel
    name: ClassVar[str]
    combine: ClassVar[np.ufunc]

    def __call__(self, x: Array, y: Array) -> Array:  # noqa: D102
        return np.asarray(self.combine(self.left(x, y), self.right(x, y)))

    def diagonal(self, x: Array) -> Array:  # noqa: D102
        return np.asarray(self.combine(self.left.diagonal(x), self.right.diagonal(x)))

    @property
    def is_positive(self) -> bool:  # noqa: D102
        return self.left.is_positive and self.right.is_positive

    def terms(self) -> tuple[Term, ...]:  # noqa: D102
        return (*self.left.terms(), *self.right.terms(), Term(self.name, ()))


@dataclass(frozen=True)
class Sum(Pair):
    """Sum of two kernels."""

    name, combine = "sum", np.add


@dataclass(frozen=True)
class Product(Pair):
    """Product of two kernels."""

    name, combine = "product", np.multiply


def _gaussian(x: Array, y: Array) -> Array:
    gram: Array = cdist(x, y, "sqeuclidean")
    np.multiply(gram, -0.5, out=gram)
    np.exp(gram, out=gram)
    return gram


def rowwise_matmul(x: Array, matrix: Array) -> Array:
    """Multiply each row of ``x``, shape (n, k), by ``matrix``, shape (k, m), independently.

    In a single matrix product, the number of other rows may change a row's last bits.
    """
    product: Array = np.matmul(x[:, None, :], matrix)[:, 0, :]
    return product


def _polynomial(parameters: tuple[float, ...]) -> Kernel:
    require(len(parameters) == 2, "polynomial parameters", "2 numbers (offset, degree)", len(parameters))
    return Polynomial(parameters[0], parameters[1])  # type: ignore[arg-type]  # Polynomial checks that it is whole


def _linear(parameters: tuple[float, ...]) -> Kernel:
    require(len(parameters) % 2 == 0, "linear parameters", "as many centres as scales", f"{len(parameters)} numbers")
    half = len(parameters) // 2
    return Linear(parameters[:half], parameters[half:])


# A new kernel may also need entries in learning/kernel_choice.py and policies/onnx_export.py: docs/custom_kernel.md.
LEAVES: dict[str, Callable[[tuple[float, ...]], Kernel]] = {
    "rbf": RBF,
    "polynomial": _polynomial,
    "linear": _linear,
}
COMPOSITIONS: dict[str, Callable[[Kernel, Kernel], Kernel]] = {"sum": Sum, "product": Product}


def kernel_from_terms(terms: Iterable[tuple[str, Sequence[float]]]) -> Kernel:
    """Rebuild a kernel from its terms in postfix order.

    Raises:
        ValueError: a name is unknown, a parameter is out of range, or the terms do not form one kernel.
    """
    stack: list[Kernel] = []
    for count, (name, parameters) in enumerate(terms, 1):
        require(count <= MAX_KERNEL_TERMS, "kernel terms", f"at most {MAX_KERNEL_TERMS}", "more")
        pick(name, {**LEAVES, **COMPOSITIONS}, "kernel")
        if name in LEAVES:
            stack.append(LEAVES[name](tuple(map(float, parameters))))
        else:
            require(len(stack) >= 2, f"kernel '{name}'", "two kernels before it", len(stack))
            require(len(parameters) == 0, f"kernel '{name}' parameters", "none", f"{len(parameters)} numbers")
            right, left = stack.pop(), stack.pop()
            stack.append(COMPOSITIONS[name](left, right))
    require(len(stack) == 1, "kernel terms", "one kernel in postfix order", f"{len(stack)} kernels")
    return stack[0]


def subsample(rows: Array, most: int) -> Array:
    """Return at most ``most`` evenly spaced rows of a non-empty array."""
    return rows[:: -(-len(rows) // most)]


def median_bandwidth(points: ArrayLike, most: int = 1000) -> tuple[float, ...]:
    """Return the median distance between pairs of points along each dimension (the median heuristic).

    If the standard deviation is larger, return that instead: when many points coincide, for example at the end of a
    joint's range, the median ignores the remaining points. For normally distributed points the median is 0.95 standard
    deviations. If all points coincide up to rounding, the bandwidth is 1.

    Args:
        points: shape (n, d), n at least 1.
        most: maximum number of points, evenly spaced, from which pairs are formed.
    """
    array = np.asarray(points, dtype=float)
    array = subsample(array, most)
    if len(array) == 1:
        return tuple(1.0 for _ in array.T)
    spreads = ((float(np.median(pdist(column[:, None], "cityblock"))), float(column.std())) for column in array.T)
    least = ROUNDING * np.abs(array).max(axis=0)
    return tuple(spread if spread > low else 1.0 for spread, low in zip(map(max, spreads), least, strict=True))


def spreads(points: Array, weights: Array | None = None) -> Array:
    """Return the standard deviation of each column of points; 0 if the column is constant up to rounding.

    Args:
        points: shape (n, d), n at least 1.
        weights: weight of each point, shape (n,); None for 1.
    """
    squares = (points - np.average(points, axis=0, weights=weights)) ** 2
    sd = np.sqrt(np.average(squares, axis=0, weights=weights))
    return np.where(sd > ROUNDING * np.abs(points).max(axis=0), sd, 0.0)


def deviations(points: Array, weights: Array | None = None) -> Array:
    """Return the standard deviation of each column of points; 1 if the column is constant up to rounding."""
    sd = spreads(points, weights)
    return np.where(sd > 0, sd, 1.0)
