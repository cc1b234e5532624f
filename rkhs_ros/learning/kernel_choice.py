"""The settings of the kernel, whose bandwidths may be taken from the first iteration's points."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import reduce
from operator import add, mul

import numpy as np

from rkhs_ros.base.settings import Settings, setting
from rkhs_ros.base.validation import numbers, pick, require
from rkhs_ros.rkhs.kernels import RBF, Array, Kernel, Linear, Polynomial, deviations, median_bandwidth


@dataclass(frozen=True)
class KernelChoice(Settings):
    """The settings of the policy's kernel."""

    form: str = setting("rbf", "names of kernels joined by + and *, as in 'rbf + polynomial'")
    bandwidth: str | tuple[float, ...] = setting(
        "median",
        "bandwidths of rbf in the inputs' units: one, one per input, or one per number of a window's entry, the same "
        "at every age; or 'median': along each dimension the median distance of pairs of the first iteration's points, "
        "or their standard deviation where it is larger; or 'dimension': their standard deviation times root(d / 2), "
        "which keeps the kernel of typical points the same in any dimension d",
        minimum=1e-9,
        maximum=1e9,
        choices=("median", "dimension"),
    )
    bandwidth_scale: float = setting(1.0, "factor on the bandwidths", minimum=1e-6, maximum=1e6)
    offset: float = setting(1.0, "offset c of the polynomial kernel", minimum=0.0, maximum=1e6)
    degree: int = setting(3, "degree of the polynomial kernel", minimum=1, maximum=20)

    def __post_init__(self) -> None:
        """Raise ValueError where a value does not fit, or the form names an unknown kernel."""
        super().__post_init__()
        for name in self.form.replace("*", "+").split("+"):
            pick(name.strip(), KERNELS, "kernel")

    def unused(self) -> set[str]:
        """Return the names of the settings of kernels that are not in the form."""
        own = {"rbf": {"bandwidth", "bandwidth_scale"}, "polynomial": {"offset", "degree"}}
        return set().union(*(names for kernel, names in own.items() if kernel not in self.form))

    def fit(self, points: Array, ages: int = 1) -> Kernel:
        """Return the kernel, its bandwidths taken from the points where they are not given.

        Args:
            points: shape (n, d), n at least 1.
            ages: number of entries of a window that a point is made of, each of d / ages numbers.

        Raises:
            ValueError: the bandwidths given are neither one, nor one per number of a point, nor of an entry.
        """
        products = (factors.split("*") for factors in self.form.split("+"))
        return reduce(add, (reduce(mul, (KERNELS[f.strip()](self, points, ages) for f in p)) for p in products))

    def bandwidths(self, points: Array, ages: int) -> tuple[float, ...]:
        """Return the bandwidths times their scale: one, or one per dimension of the points."""
        d = points.shape[1]
        bandwidth = self._measured(points) if isinstance(self.bandwidth, str) else self.bandwidth
        good = len(bandwidth) in (1, d // ages, d)
        require(good, "kernel.bandwidth", f"{numbers(1, d // ages, d)}, for the policy's inputs", len(bandwidth))
        repeats = ages if len(bandwidth) == d // ages != 1 else 1
        return tuple(self.bandwidth_scale * b for b in bandwidth * repeats)

    def _measured(self, points: Array) -> tuple[float, ...]:
        if self.bandwidth == "median":
            return median_bandwidth(points)
        return tuple((deviations(points) * np.sqrt(points.shape[1] / 2.0)).tolist())

    def _rbf(self, points: Array, ages: int) -> Kernel:
        return RBF(self.bandwidths(points, ages))

    def _linear(self, points: Array, ages: int) -> Kernel:
        return Linear(tuple(points.mean(axis=0)), tuple(deviations(points)))

    def _polynomial(self, points: Array, ages: int) -> Kernel:
        return Polynomial(self.offset, self.degree)


KERNELS: dict[str, Callable[[KernelChoice, Array, int], Kernel]] = {
    "rbf": KernelChoice._rbf,
    "polynomial": KernelChoice._polynomial,
    "linear": KernelChoice._linear,
}
