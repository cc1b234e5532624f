"""The settings of the kernel, whose bandwidths may be taken from the first iteration's points."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import reduce
from operator import add, mul

from rkhs_ros.base.settings import Settings, setting
from rkhs_ros.base.validation import pick
from rkhs_ros.rkhs.kernels import RBF, Array, Kernel, Polynomial, median_bandwidth


@dataclass(frozen=True)
class KernelChoice(Settings):
    """The settings of the policy's kernel."""

    form: str = setting("rbf", "names of kernels joined by + and *, as in 'rbf + polynomial'")
    bandwidth: str | tuple[float, ...] = setting(
        "median",
        "bandwidths of rbf in the inputs' units: one, one per input, or one per number of a window's entry, the same "
        "at every age; or 'median': along each dimension the median distance of pairs of the first iteration's points, "
        "or their standard deviation where it is larger",
        minimum=1e-9,
        maximum=1e9,
        choices=("median",),
    )
    bandwidth_scale: float = setting(1.0, "factor on the bandwidths", minimum=1e-6, maximum=1e6)
    offset: float = setting(1.0, "offset c of the polynomial kernel", minimum=0.0, maximum=1e6)
    degree: int = setting(3, "degree of the polynomial kernel", minimum=1, maximum=20)

    def __post_init__(self) -> None:
        """Raise ValueError where a value does not fit, or the form names an unknown kernel."""
        super().__post_init__()
        for name in self.form.replace("*", "+").split("+"):
            pick(name.strip(), KERNELS, "kernel")

    def fit(self, points: Array) -> Kernel:
        """Return the kernel, its bandwidths taken from points of shape (n, d) where they are not given."""
        products = (factors.split("*") for factors in self.form.split("+"))
        return reduce(add, (reduce(mul, (KERNELS[f.strip()](self, points) for f in p)) for p in products))

    def _rbf(self, points: Array) -> Kernel:
        bandwidth = median_bandwidth(points) if isinstance(self.bandwidth, str) else self.bandwidth
        ages, rest = divmod(points.shape[1], len(bandwidth))
        repeats = 1 if rest or len(bandwidth) == 1 else ages
        return RBF(tuple(self.bandwidth_scale * b for b in bandwidth * repeats))

    def _polynomial(self, points: Array) -> Kernel:
        return Polynomial(self.offset, self.degree)


KERNELS: dict[str, Callable[[KernelChoice, Array], Kernel]] = {
    "rbf": KernelChoice._rbf,
    "polynomial": KernelChoice._polynomial,
}
