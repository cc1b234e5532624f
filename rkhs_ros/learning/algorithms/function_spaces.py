"""Function spaces of the search: the RKHS with few centres, or the span of kernel functions on a grid."""

from dataclasses import dataclass
from math import prod
from typing import Protocol

import numpy as np

from rkhs_ros.base.settings import setting
from rkhs_ros.base.validation import numbers, require
from rkhs_ros.learning.episodes import Episodes
from rkhs_ros.learning.samples import Samples
from rkhs_ros.policies.gaussian import GaussianPolicy
from rkhs_ros.rkhs.function import Function, grid
from rkhs_ros.rkhs.kernels import Array, Polynomial
from rkhs_ros.rkhs.pursuit import sparsify

LINEAR = Polynomial(0.0, 1)
MAX_GRID_CENTRES = 100_000


class FunctionSpace(Protocol):
    """A space of functions in which the policy's mean is searched."""

    def samples(self, policy: GaussianPolicy, episodes: Episodes) -> Samples:
        """Return the steps of episodes in coordinates of the space."""

    def move(self, policy: GaussianPolicy, direction: Function, points: Array) -> tuple[GaussianPolicy, float]:
        """Return the policy with the direction added to its mean, and the relative error of the sparsification.

        Args:
            policy: the policy.
            direction: a function of the space.
            points: points at which the mean's values are fitted, shape (samples, d).
        """


@dataclass(frozen=True)
class Sparse:
    """The RKHS with centres selected among the samples and sparsified after every update (Algorithm 1).

    Attributes:
        centres: maximum number of centres of the policy.
    """

    centres: int

    def samples(self, policy: GaussianPolicy, episodes: Episodes) -> Samples:
        """Return the samples in a Newton basis.

        For a linear kernel, the basis is the unit vectors, which are orthonormal and span the whole space. A basis of
        samples would lose features that are much smaller than others.
        """
        if policy.mean.kernel == LINEAR and policy.mean.input_dim <= self.centres:
            return Samples.on_centres(policy, episodes, np.eye(policy.mean.input_dim))
        return Samples.in_newton_basis(policy, episodes, self.centres)

    def move(self, policy: GaussianPolicy, direction: Function, points: Array) -> tuple[GaussianPolicy, float]:
        """Return the policy with the direction added to its sparsified mean, and the relative error."""
        mean = policy.mean + direction
        if len(mean.centres) <= self.centres:
            return policy.with_mean(mean), 0.0
        fit = sparsify(mean, points, budget=self.centres)
        return policy.with_mean(fit.function), fit.error


@dataclass(frozen=True)
class Grid:
    """The span of kernel functions on a fixed grid, with the Euclidean norm of the weights (Eq 3).

    Attributes:
        low: lower corner, one number or one per input.
        high: upper corner, one number or one per input.
        counts: number of centres along each dimension, one whole number or one per input.
    """

    low: tuple[float, ...]
    high: tuple[float, ...]
    counts: tuple[float, ...]

    def samples(self, policy: GaussianPolicy, episodes: Episodes) -> Samples:
        """Return the samples in the basis of the grid's kernel functions."""
        return Samples.on_centres(policy, episodes, self.centres(policy.mean.input_dim))

    def move(self, policy: GaussianPolicy, direction: Function, points: Array) -> tuple[GaussianPolicy, float]:
        """Return the policy with the direction's weights added, and an error of 0."""
        return policy.with_mean(policy.mean + direction), 0.0

    def centres(self, d: int) -> Array:
        """Return the points of the grid over d inputs, shape (m, d).

        Raises:
            ValueError: there are not one or d numbers, a count is not whole, or there are too many centres.
        """
        corners = {"grid_low": self.low, "grid_high": self.high, "grid_counts": self.counts}
        for name, given in corners.items():
            require(len(given) in (1, d), f"algorithm.{name}", numbers(1, d), len(given))
        low, high, counts = (np.broadcast_to(given, (d,)) for given in corners.values())
        require(all(count == int(count) for count in counts), "algorithm.grid_counts", "whole numbers", counts.tolist())
        sizes = tuple(int(count) for count in counts)
        most = f"at most {MAX_GRID_CENTRES} centres in total"
        require(prod(sizes) <= MAX_GRID_CENTRES, "algorithm.grid_counts", most, prod(sizes))
        return grid(low, high, sizes)


@dataclass(frozen=True)
class SparseSettings:
    """Settings of algorithms that search the RKHS."""

    centres: int = setting(80, "maximum number of centres of the policy", minimum=1, maximum=2000)

    @property
    def space(self) -> Sparse:
        """Function space of the search."""
        return Sparse(self.centres)


@dataclass(frozen=True)
class GridSettings:
    """Settings of algorithms that search the weights on a grid of centres."""

    grid_low: tuple[float, ...] = setting(
        (-1.0,), "lower corner of the grid of centres, one number or one per input", minimum=-1e9, maximum=1e9
    )
    grid_high: tuple[float, ...] = setting(
        (1.0,), "upper corner of the grid of centres, one number or one per input", minimum=-1e9, maximum=1e9
    )
    grid_counts: tuple[float, ...] = setting(
        (5.0,), "number of centres along each dimension, one number or one per input", minimum=1, maximum=10_000
    )

    @property
    def space(self) -> Grid:
        """Function space of the search."""
        return Grid(self.grid_low, self.grid_high, self.grid_counts)
