"""Function spaces of the search: the RKHS with few centres, or the span of kernel functions on a grid."""

from dataclasses import dataclass, replace
from math import prod

import numpy as np

from rkhs_ros.base.settings import Settings, setting
from rkhs_ros.base.validation import require
from rkhs_ros.learning.episodes import Episodes
from rkhs_ros.learning.samples import Samples
from rkhs_ros.policies.gaussian import GaussianPolicy
from rkhs_ros.rkhs.function import Function, grid
from rkhs_ros.rkhs.kernels import LINEAR, Array
from rkhs_ros.rkhs.pursuit import sparsify

MAX_GRID_CENTRES = 100_000


@dataclass(frozen=True)
class Sparse(Settings):
    """Base class of algorithms that search the RKHS.

    Centres are selected among the samples and sparsified after every update (Algorithm 1).
    """

    centres: int = setting(80, "maximum number of centres of the policy", minimum=1, maximum=2000)

    def samples(self, policy: GaussianPolicy, episodes: Episodes) -> Samples:
        """Return the steps of episodes in a Newton basis.

        For a linear kernel, the basis is the unit vectors, which are orthonormal and span the whole space. A basis of
        samples would lose features that are much smaller than others.
        """
        if policy.mean.kernel == LINEAR and policy.mean.input_dim <= self.centres:
            return Samples.on_centres(policy, episodes, np.eye(policy.mean.input_dim))
        return Samples.in_newton_basis(policy, episodes, self.centres)

    def move(self, policy: GaussianPolicy, direction: Function, points: Array) -> tuple[GaussianPolicy, float]:
        """Return the policy with the direction added to its mean, and the relative error of the sparsification.

        Args:
            policy: the policy.
            direction: a function of the space.
            points: points at which the mean's values are fitted, shape (samples, d).
        """
        mean = policy.mean + direction
        if len(mean.centres) <= self.centres:
            return policy.with_mean(mean), 0.0
        fit = sparsify(mean, points, budget=self.centres)
        return policy.with_mean(fit.function), fit.error


@dataclass(frozen=True)
class Grid(Settings):
    """Base class of algorithms that search the weights on a fixed grid of centres, with their Euclidean norm (Eq 3)."""

    grid: tuple[float, ...] = setting(
        (-1.0, 1.0, 5.0),
        "lower end, upper end and number of the centres along each input: 3 numbers for all inputs, or 3 for each; "
        "those of the inputs of a time step repeat over a history",
        minimum=-1e9,
        maximum=1e9,
    )

    def __post_init__(self) -> None:
        """Raise ValueError if a value is invalid or the number of centres along an input is not a whole number."""
        super().__post_init__()
        good = len(self.grid) % 3 == 0 and all(count >= 1 and count == int(count) for count in self.grid[2::3])
        require(good, "algorithm.grid", "lower end, upper end and whole number of centres", self.grid)

    def samples(self, policy: GaussianPolicy, episodes: Episodes) -> Samples:
        """Return the steps of episodes in the basis of the grid's kernel functions."""
        return Samples.on_centres(policy, episodes, self.grid_centres(policy.mean.input_dim))

    def move(self, policy: GaussianPolicy, direction: Function, points: Array) -> tuple[GaussianPolicy, float]:
        """Return the policy with the direction's weights added, and an error of 0."""
        mean, own = policy.mean, len(direction.centres)
        others = len(mean.centres) - own  # of an initial policy
        if others <= 0 or not np.array_equal(mean.centres[others:], direction.centres):
            return policy.with_mean(mean + direction), 0.0
        weights = np.concatenate([mean.weights[:others], mean.weights[others:] + direction.weights])
        return policy.with_mean(replace(mean, weights=weights)), 0.0

    def grid_centres(self, d: int) -> Array:
        """Return the centres for d inputs, shape (m, d); raise ValueError if they do not fit."""
        axes = np.reshape(self.grid, (-1, 3))
        require(d % len(axes) == 0, "algorithm.grid", f"3 numbers, or 3 for each of {d} inputs", len(self.grid))
        low, high, counts = np.tile(axes, (d // len(axes), 1)).T
        sizes = tuple(int(count) for count in counts)
        most = f"at most {MAX_GRID_CENTRES} centres in total"
        require(prod(sizes) <= MAX_GRID_CENTRES, "algorithm.grid", most, prod(sizes))
        return grid(low, high, sizes)
