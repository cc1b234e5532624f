"""The Gaussian policy with mean and variance in reproducing kernel Hilbert spaces."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from rkhs_ros.base.endings import RunError
from rkhs_ros.base.validation import all_finite, pick, require, truncated
from rkhs_ros.policies.inputs import Inputs
from rkhs_ros.policies.noise import FILTERS
from rkhs_ros.policies.streams import Batch
from rkhs_ros.policies.variance import ConstantVariance, Variance
from rkhs_ros.rkhs.function import Function
from rkhs_ros.rkhs.kernels import Array

MOST_NUMBERS = 10**8  # that a batch is remembered by, so that no message can ask for more memory than there is


@dataclass(frozen=True)
class GaussianPolicy:
    r"""The policy :math:`a \sim N(h(s), \Sigma(s))` with diagonal :math:`\Sigma` (Eq 2).

    Attributes:
        mean: the function h.
        variance: the diagonal of Sigma.
        inputs: what mean and variance are given of the history; the methods take it as ``observations``.
        noise: how the exploration of an episode is correlated over time, one of ``NOISES``; the distribution of each
            action by itself is the same.
    """

    mean: Function
    variance: Variance
    inputs: Inputs = Inputs()
    noise: str = "white"

    def __post_init__(self) -> None:
        """Raise ValueError where mean and variance differ in their dimensions, or the noise is unknown."""
        pick(self.noise, FILTERS, "noise")
        require(
            self.mean.output_dim == self.variance.output_dim,
            "variance",
            f"{self.mean.output_dim} action dimensions, as the mean has",
            self.variance.output_dim,
        )
        if not isinstance(self.variance, ConstantVariance):
            d = self.mean.input_dim
            require(self.variance.input_dim == d, "variance centres", f"{d} columns", self.variance.input_dim)

    def act(self, observations: Array, exploration: Array) -> Array:
        """Return actions, shape (batch, n), from standard normal draws for the first rows; the others take the mean."""
        actions, exploring = self.mean(observations), len(exploration)
        if exploring:
            actions[:exploring] += np.sqrt(self.variance(observations[:exploring])) * exploration
        return actions

    def exploration(self, batch: Batch) -> Array:
        """Return the standard normal draws of all steps of the rows that explore, shape (rows, horizon, n)."""
        return FILTERS[self.noise](batch.exploration(self.mean.output_dim))

    def score(self, observations: Array, actions: Array) -> Array:
        r"""Return the coefficients :math:`u = \Sigma^{-1}(a - h(s))`, shape (batch, n), of Eq 8."""
        return (actions - self.mean(observations)) / self.variance(observations)

    def with_mean(self, mean: Function) -> GaussianPolicy:
        """Return the policy with another mean."""
        return replace(self, mean=mean)


def mean_kl(mean: Array, before: Array, new: GaussianPolicy, observations: Array) -> float:
    r"""Return the mean over states of :math:`KL(\pi_{old} \| \pi_{new})`, in nats.

    Args:
        mean: of the old policy in these states, shape (batch, n).
        before: its variance there, shape (batch, n).
        new: the new policy.
        observations: the states, shape (batch, d).
    """
    after, squares = new.variance(observations), (mean - new.mean(observations)) ** 2
    terms = np.log(after / before) + (before + squares) / after - 1.0
    return float(0.5 * terms.sum(axis=1).mean())


class Acting:
    """A policy that acts through the steps of one batch of episodes.

    Owns what its window looks back on, filed by step, so that a step asked for twice is answered alike.

    Args:
        policy: the policy, the same throughout the batch.
        batch: the episodes.
        explore: whether the actions of exploring episodes are drawn; all are by the mean otherwise.
    """

    def __init__(self, policy: GaussianPolicy, batch: Batch, *, explore: bool) -> None:
        self.policy = policy
        self.batch = batch
        self._explore = explore
        self._require_room(max(batch.horizon * policy.mean.output_dim, *policy.mean.centres.shape))
        self._mean = policy.mean.prepared()
        variance = policy.variance
        self._constant_sd = np.sqrt(variance.values) if isinstance(variance, ConstantVariance) else None
        self._columns = 0  # of the observations, not known yet
        self._seen = self._done = np.zeros((batch.num_envs, batch.horizon, 0))

    def __call__(self, step: int, observations: Array) -> Array:
        """Return the actions of a step, shape (rows, n), for observations of shape (rows, d).

        Raises:
            ValueError: the observations are not what the policy takes.
            RunError: an action is not finite.
        """
        inputs = self.policy.inputs
        if observations.shape[1] != self._columns:
            self._make_ready(observations.shape[1])
        if inputs.history == 1:
            return self._act(step, inputs.features(observations))
        self._seen[:, step] = observations
        actions = self._act(step, inputs.at(np.array([step]), self._seen, self._done)[:, 0])
        self._done[:, step] = actions
        return actions

    def _make_ready(self, columns: int) -> None:
        """Check that the policy takes observations of so many numbers, and make room for those of a window."""
        mean, rows, horizon = self.policy.mean, self.batch.num_envs, self.batch.horizon
        size = self.policy.inputs.dimension(columns, mean.output_dim)
        require(size == mean.input_dim, "points", f"{mean.input_dim} columns", size)
        if self.policy.inputs.history > 1:
            self._require_room(horizon * max(columns, mean.output_dim))
            self._seen = np.zeros((rows, horizon, columns))
            self._done = np.zeros((rows, horizon, mean.output_dim))
        self._columns = columns

    def _require_room(self, row: int) -> None:
        numbers = self.batch.num_envs * row
        require(numbers <= MOST_NUMBERS, "batch", f"at most {MOST_NUMBERS} numbers at a time", numbers)

    @np.errstate(over="ignore", invalid="ignore")  # reported by row and step instead
    def _act(self, step: int, points: Array) -> Array:
        actions = self._mean(points)
        noise = self._exploration[:, step]
        exploring = len(noise)
        if exploring:
            if self._constant_sd is None:
                noise = np.sqrt(self.policy.variance(points[:exploring])) * noise
            actions[:exploring] += noise
        if not all_finite(actions):
            row = int(np.isfinite(actions).all(axis=1).argmin())
            raise RunError(
                f"the policy's action in row {row}, step {step + 1}: "
                f"expected finite numbers, got {truncated(actions[row])}"
            )
        return actions

    @cached_property
    def _exploration(self) -> Array:
        """The draws of the whole batch, times the standard deviation if it is constant.

        They are made once it is known that the policy fits what is observed.
        """
        policy, horizon = self.policy, self.batch.horizon
        if not self._explore:
            return np.zeros((0, horizon, policy.mean.output_dim))
        draws = policy.exploration(self.batch)
        return draws if self._constant_sd is None else self._constant_sd * draws
