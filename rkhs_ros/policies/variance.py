"""The variance of a Gaussian policy: constant, or a function of the state."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from rkhs_ros.base.validation import finite_array, require
from rkhs_ros.rkhs.function import BLOCK_ROWS, Function
from rkhs_ros.rkhs.kernels import Array, Kernel, rowwise_matmul
from rkhs_ros.rkhs.regression import by_blocks

MOST_STEP = 100.0  # largest change of a log variance in one step; larger steps reach the bounds anyway


@dataclass(frozen=True)
class ConstantVariance:
    """A diagonal variance that does not depend on the state.

    Attributes:
        values: variance of each action dimension, shape (n,), positive.
    """

    values: Array

    def __post_init__(self) -> None:
        """Raise ValueError if a variance is not positive."""
        object.__setattr__(self, "values", _positive(self.values, "variance"))

    @property
    def output_dim(self) -> int:
        """Number of action dimensions."""
        return len(self.values)

    def __call__(self, x: Array) -> Array:
        """Evaluate at points of shape (batch, d): shape (batch, n)."""
        variances = np.empty((len(x), len(self.values)))
        variances[:] = self.values  # faster than numpy.full for few values
        return variances

    def decay(self, factor: float, minimum_sd: float) -> ConstantVariance:
        """Return the variance with the standard deviation multiplied by ``factor``, but at least ``minimum_sd``."""
        floor = np.minimum(self.values, minimum_sd**2)
        return ConstantVariance(np.maximum(self.values * factor**2, floor))

    def moved(self, step: Array, least: Array, most: Array) -> ConstantVariance:
        r"""Return the variance after a step of :math:`\sqrt2 \log\sigma` for each action, clipped to bounds.

        Args:
            step: shape (n,), of any size.
            least: lower bound of the variance, shape (n,), positive.
            most: upper bound of the variance, shape (n,).
        """
        factor = np.exp(np.clip(np.sqrt(2.0) * step, -MOST_STEP, MOST_STEP))
        return ConstantVariance(np.minimum(np.maximum(self.values * factor, least), most))


@dataclass(frozen=True)
class KernelVariance:
    r"""A kernel-weighted mean of observed variances, clipped to bounds.

    .. math:: g(s) = \frac{\sum_j m_j v_j \kappa(c_j, s)}{\sum_j m_j \kappa(c_j, s)}

    This corrects Eq 24: the published form divides squared exploration by squared exploration, so its value is not a
    variance. If all kernel values vanish, the variance is the mean over all centres.

    Attributes:
        kernel: a kernel without negative values, as required for weights.
        centres: shape (m, d), m at least 1.
        mass: weight of each centre, shape (m,), positive.
        values: variance at each centre, shape (m, n), not negative.
        minimum: lower bound, shape (n,), positive.
        maximum: upper bound, shape (n,).
    """

    kernel: Kernel
    centres: Array
    mass: Array
    values: Array
    minimum: Array
    maximum: Array

    def __post_init__(self) -> None:
        """Raise ValueError if shapes do not match or numbers are out of range."""
        require(self.kernel.is_positive, "variance kernel", "one without negative values", self.kernel)
        m, n = np.shape(self.values)
        require(m >= 1, "variance centres", "at least one", m)
        for name, shape in (("centres", (m, np.shape(self.centres)[-1])), ("mass", (m,)), ("values", (m, n))):
            object.__setattr__(self, name, finite_array(getattr(self, name), shape, f"variance {name}"))
        _positive(self.mass, "variance mass")
        require(bool((self.values >= 0).all()), "variance values", "numbers >= 0", self.values.min())
        _set_bounds(self, n)

    @property
    def input_dim(self) -> int:
        """Dimension of the points."""
        return int(self.centres.shape[1])

    @property
    def output_dim(self) -> int:
        """Number of action dimensions."""
        return int(self.values.shape[1])

    def __call__(self, x: Array) -> Array:
        """Evaluate at points of shape (batch, d): shape (batch, n); each row depends only on its own point."""
        return by_blocks(lambda rows: self._at(x[rows]), len(x), BLOCK_ROWS)

    def _at(self, x: Array) -> Array:
        near = self.kernel(x, self.centres) * self.mass
        total = near.sum(axis=1, keepdims=True)
        near = np.where(total > np.finfo(float).tiny, near, self.mass)
        mean = rowwise_matmul(near, self.values) / near.sum(axis=1, keepdims=True)
        return np.asarray(np.clip(mean, self.minimum, self.maximum))


@dataclass(frozen=True)
class FunctionVariance:
    r"""A function of the state, clipped to bounds: Eq 24 as published.

    .. math:: g(s) = \sum_j \kappa(c_j, s)\,\beta_j

    Attributes:
        function: g before clipping.
        minimum: lower bound, shape (n,), positive.
        maximum: upper bound, shape (n,).
    """

    function: Function
    minimum: Array
    maximum: Array

    def __post_init__(self) -> None:
        """Raise ValueError if shapes do not match or the bounds are invalid."""
        _set_bounds(self, self.output_dim)

    @property
    def input_dim(self) -> int:
        """Dimension of the points."""
        return self.function.input_dim

    @property
    def output_dim(self) -> int:
        """Number of action dimensions."""
        return self.function.output_dim

    def __call__(self, x: Array) -> Array:
        """Evaluate at points of shape (batch, d): shape (batch, n); each row depends only on its own point."""
        return np.asarray(np.clip(self.function(x), self.minimum, self.maximum))


Variance = ConstantVariance | KernelVariance | FunctionVariance


def parts_of(variance: Variance) -> tuple[Kernel | None, dict[str, Array]]:
    """Return the kernel of a variance, None if it is constant, and its arrays by name, for files and messages."""
    if isinstance(variance, ConstantVariance):
        return None, {"values": variance.values}
    if isinstance(variance, FunctionVariance):
        g = variance.function
        kernel, parts = g.kernel, {"values": g.weights, "centres": g.centres}
    else:
        kernel, parts = variance.kernel, {name: getattr(variance, name) for name in ("values", "centres", "mass")}
    return kernel, parts | {"minimum": variance.minimum, "maximum": variance.maximum}


def variance_from(kernel: Kernel | None, parts: Mapping[str, Array]) -> Variance:
    """Return the variance with these parts, see `parts_of`.

    Raises:
        KeyError: a part is missing.
        ValueError: the parts do not form a valid variance.
    """
    if kernel is None:
        return ConstantVariance(parts["values"])
    centres, values, *bounds = (parts[name] for name in ("centres", "values", "minimum", "maximum"))
    if "mass" not in parts:
        return FunctionVariance(Function(kernel, centres, values), *bounds)
    return KernelVariance(kernel, centres, parts["mass"], values, *bounds)


def _set_bounds(variance: KernelVariance | FunctionVariance, n: int) -> None:
    """Check the bounds of a variance and store them as arrays."""
    for bound in ("minimum", "maximum"):
        array = finite_array(getattr(variance, bound), (n,), f"variance {bound}")
        object.__setattr__(variance, bound, _positive(array, f"variance {bound}"))
    good = bool((variance.minimum <= variance.maximum).all())
    require(good, "variance minimum", "at most the maximum", variance.minimum)


def _positive(values: Array, what: str) -> Array:
    array = finite_array(values, np.shape(values), what)
    require(array.ndim == 1 and bool((array > 0).all()), what, "positive numbers (one-dimensional)", values)
    return array
