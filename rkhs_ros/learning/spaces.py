"""The spaces searched: all of the RKHS with few centres at a time, or the span of fixed centres on a grid."""

from __future__ import annotations

from dataclasses import dataclass
from math import prod

import numpy as np

from rkhs_ros.base.settings import setting
from rkhs_ros.base.validation import require
from rkhs_ros.learning.algorithm import Algorithm
from rkhs_ros.learning.episodes import Episodes
from rkhs_ros.learning.features import Samples
from rkhs_ros.policies.gaussian import GaussianPolicy
from rkhs_ros.rkhs.fixed import grid
from rkhs_ros.rkhs.function import Function
from rkhs_ros.rkhs.kernels import Array, Polynomial
from rkhs_ros.rkhs.pursuit import sparsify

LINEAR = Polynomial(0.0, 1)
MOST = 100_000  # centres on a grid


@dataclass(frozen=True)
class Sparse(Algorithm):
    """The RKHS: centres are chosen among what was seen, and thinned out after every update (Algorithm 1)."""

    centres: int = setting(40, "number of centres of the policy at most", minimum=1, maximum=2000)
    sparsification_tolerance: float = setting(
        0.0, "relative error at which fewer centres are enough", minimum=0.0, maximum=1.0
    )

    def samples(self, policy: GaussianPolicy, episodes: Episodes) -> Samples:
        """Return the samples in the Newton basis of some of them.

        The unit vectors span all of a linear kernel's space and are orthonormal in it; where features have very
        different sizes, a basis of samples would lose the small ones.
        """
        if policy.mean.kernel == LINEAR and policy.mean.input_dim <= self.centres:
            return Samples.on(policy, episodes, np.eye(policy.mean.input_dim))
        return Samples.of(policy, episodes, self.centres)

    def move(self, policy: GaussianPolicy, direction: Function, points: Array) -> tuple[GaussianPolicy, float]:
        """Return the policy with the direction added to its mean, sparsified, and the relative error of that."""
        mean = policy.mean + direction
        if len(mean.centres) <= self.centres and self.sparsification_tolerance == 0.0:
            return policy.with_mean(mean), 0.0
        fit = sparsify(mean, points, budget=self.centres, tolerance=self.sparsification_tolerance)
        return policy.with_mean(fit.function), fit.error


@dataclass(frozen=True)
class OnGrid(Algorithm):
    """A parametric policy: weights of kernel functions on a fixed grid, measured by their Euclidean norm (Eq 3)."""

    grid_low: tuple[float, ...] = setting(
        (-1.0,), "lower corner of the grid of centres, one or one per input", minimum=-1e9, maximum=1e9
    )
    grid_high: tuple[float, ...] = setting(
        (1.0,), "upper corner of the grid of centres, one or one per input", minimum=-1e9, maximum=1e9
    )
    grid_counts: tuple[float, ...] = setting(
        (5.0,), "centres along each dimension, one or one per input", minimum=1, maximum=10_000
    )

    def samples(self, policy: GaussianPolicy, episodes: Episodes) -> Samples:
        """Return the samples in the kernel functions of the grid."""
        return Samples.on(policy, episodes, self._centres(policy.mean.input_dim))

    def move(self, policy: GaussianPolicy, direction: Function, points: Array) -> tuple[GaussianPolicy, float]:
        """Return the policy with the direction's weights added."""
        return policy.with_mean(policy.mean + direction), 0.0

    def _centres(self, d: int) -> Array:
        for name in ("grid_low", "grid_high", "grid_counts"):
            size = len(getattr(self, name))
            require(size in (1, d), f"algorithm.{name}", f"1 or {d} numbers", size)
        low, high, counts = (np.broadcast_to(v, (d,)) for v in (self.grid_low, self.grid_high, self.grid_counts))
        require(all(count == int(count) for count in counts), "algorithm.grid_counts", "whole numbers", counts.tolist())
        sizes = tuple(int(count) for count in counts)
        require(prod(sizes) <= MOST, "algorithm.grid_counts", f"at most {MOST} centres in all", prod(sizes))
        return grid(low, high, sizes)
