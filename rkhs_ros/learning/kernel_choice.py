"""Settings of the policy's kernel, whose bandwidths can be estimated from data."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import reduce
from operator import add, mul

import numpy as np

from rkhs_ros.base.settings import Settings, setting
from rkhs_ros.base.validation import numbers, pick, require
from rkhs_ros.policies.inputs import Inputs
from rkhs_ros.rkhs.kernels import LINEAR, RBF, Array, Kernel, Linear, Polynomial, deviations, median_bandwidth

MONOMIALS = "monomials"


@dataclass(frozen=True)
class KernelChoice(Settings):
    """The settings of the policy's kernel."""

    form: str = setting(
        "rbf",
        "kernel names joined by + and *, such as 'rbf + polynomial'; or 'monomials': the polynomial kernel as a linear "
        "one of the inputs' monomials, in which a small offset loses no precision",
    )
    bandwidth: str | tuple[float, ...] = setting(
        "dimension",
        "bandwidths of rbf in the inputs' units: one number for all inputs; one number per input; or one number per "
        "input of a time step, which applies to all time steps of the history; "
        "or 'median': per dimension, the larger of the median distance between pairs of points and their standard "
        "deviation; or 'dimension': the standard deviation times sqrt(d / 2), which keeps the kernel between typical "
        "points independent of the dimension d. The points are the inputs of the first iteration, or "
        "with a model of all episodes so far",
        minimum=1e-9,
        maximum=1e9,
        choices=("median", "dimension"),
    )
    bandwidth_scale: float = setting(1.0, "factor on the bandwidths", minimum=1e-6, maximum=1e6)
    offset: float = setting(1.0, "offset c of a polynomial kernel or of monomials", minimum=0.0, maximum=1e6)
    degree: int = setting(3, "degree of a polynomial kernel or of monomials", minimum=1, maximum=20)

    def __post_init__(self) -> None:
        """Raise ValueError if a value is invalid or the form names an unknown kernel."""
        super().__post_init__()
        names = [name.strip() for name in self.form.replace("*", "+").split("+")]
        for name in names:
            pick(name, KERNELS, "kernel")
        require(MONOMIALS not in names or self.form == MONOMIALS, "kernel.form", f"{MONOMIALS} alone", self.form)

    @property
    def is_for_given_inputs(self) -> bool:
        """Whether the kernel does not fit other inputs, because there is one bandwidth per input."""
        return "rbf" in self.form and not isinstance(self.bandwidth, str) and len(self.bandwidth) > 1

    def inputs_of(self, inputs: Inputs) -> Inputs:
        """Return the inputs of the kernel: their monomials if this is its form, otherwise themselves."""
        degree, offset = (self.degree, self.offset) if self.form == MONOMIALS else (0, 1.0)
        return replace(inputs, degree=degree, offset=offset)

    def fit(self, points: Array, ages: int = 1) -> Kernel:
        """Build the kernel; bandwidths that are not given are estimated from the points.

        Args:
            points: shape (n, d), n at least 1.
            ages: number of time steps in a point, each of d / ages numbers.

        Raises:
            ValueError: the number of bandwidths is not one, one per input or one per number of a time step.
        """
        products = (factors.split("*") for factors in self.form.split("+"))
        return reduce(add, (reduce(mul, (KERNELS[f.strip()](self, points, ages) for f in p)) for p in products))

    def bandwidths(self, points: Array, ages: int) -> tuple[float, ...]:
        """Return the scaled bandwidths: one, or one per dimension of the points."""
        d = points.shape[1]
        bandwidth = self._measured(points) if isinstance(self.bandwidth, str) else self.bandwidth
        good = len(bandwidth) in (1, d // ages, d)
        require(good, "kernel.bandwidth", f"{numbers(1, d // ages, d)} for the policy's inputs", len(bandwidth))
        repeats = ages if len(bandwidth) == d // ages != 1 else 1
        return tuple(self.bandwidth_scale * b for b in bandwidth * repeats)

    def _measured(self, points: Array) -> tuple[float, ...]:
        if self.bandwidth == "median":
            return median_bandwidth(points)
        return tuple((deviations(points) * np.sqrt(points.shape[1] / 2.0)).tolist())


KERNELS: dict[str, Callable[[KernelChoice, Array, int], Kernel]] = {
    "rbf": lambda choice, points, ages: RBF(choice.bandwidths(points, ages)),
    "polynomial": lambda choice, points, ages: Polynomial(choice.offset, choice.degree),
    "linear": lambda choice, points, ages: Linear(tuple(points.mean(axis=0)), tuple(deviations(points))),
    MONOMIALS: lambda choice, points, ages: LINEAR,
}
