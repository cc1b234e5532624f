"""The Gaussian policy with mean and variance in reproducing kernel Hilbert spaces."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from rkhs_ros.base.endings import RunError
from rkhs_ros.base.validation import all_finite, pick, require, truncated
from rkhs_ros.policies.inputs import Inputs, Window
from rkhs_ros.policies.streams import FILTERS, Batch
from rkhs_ros.policies.variance import ConstantVariance, Variance
from rkhs_ros.rkhs.function import Function
from rkhs_ros.rkhs.kernels import Array

MOST_NUMBERS = 10**8  # numbers stored for a batch; limits the memory that a message can request
MOST_REPEAT = 1000  # steps for which an action is held


@dataclass(frozen=True)
class GaussianPolicy:
    r"""The policy :math:`a \sim N(h(s), \Sigma(s))` with diagonal :math:`\Sigma` (Eq 2).

    Attributes:
        mean: the function h.
        variance: the diagonal of Sigma.
        inputs: computes the inputs of mean and variance from the history; the methods take them as ``observations``.
        noise: correlation of the exploration over an episode, one of ``FILTERS``; it does not change the marginal
            distribution of a single action.
        action_repeat: number of steps for which the policy holds an action; it decides at steps 0, N, 2 N, ...
    """

    mean: Function
    variance: Variance
    inputs: Inputs = Inputs()
    noise: str = "white"
    action_repeat: int = 1

    def __post_init__(self) -> None:
        """Raise ValueError if the dimensions of mean and variance differ, or another value is invalid."""
        pick(self.noise, FILTERS, "noise")
        repeat = self.action_repeat
        require(type(repeat) is int and 1 <= repeat <= MOST_REPEAT, "action_repeat", f"1 to {MOST_REPEAT}", repeat)
        n, bounds = self.mean.output_dim, len(self.inputs.action_low)
        same = self.variance.output_dim == n
        require(same, "variance", f"{n} action dimensions like the mean", self.variance.output_dim)
        require(bounds in (0, n), "inputs.action_low", f"{n} numbers, one per action, or none", bounds)
        if not isinstance(self.variance, ConstantVariance):
            d = self.mean.input_dim
            require(self.variance.input_dim == d, "variance centres", f"{d} columns", self.variance.input_dim)

    def act(self, observations: Array, exploration: Array | None) -> Array:
        """Return actions, shape (batch, n), that explore with standard normal draws; without any, the mean."""
        actions = self.mean(observations)
        return actions if exploration is None else actions + np.sqrt(self.variance(observations)) * exploration

    def exploration(self, batch: Batch) -> Array:
        """Return the noise of exploration episodes, each draw N(0, 1), shape (num_envs, decisions, n)."""
        return FILTERS[self.noise](batch.exploration(self.mean.output_dim, self.decisions(batch.horizon)))

    @property
    def has_memory(self) -> bool:
        """Whether an action depends on earlier steps of the episode."""
        return self.inputs.history > 1 or self.action_repeat > 1

    def decisions(self, steps: int) -> int:
        """Return how many actions the policy chooses in a number of steps."""
        return -(-steps // self.action_repeat)

    def with_mean(self, mean: Function) -> GaussianPolicy:
        """Return a copy of the policy with another mean."""
        return replace(self, mean=mean)


def mean_kl(mean: Array, before: Array, new: GaussianPolicy, observations: Array) -> float:
    r"""Return the mean over states of :math:`KL(\pi_{old} \| \pi_{new})`, in nats.

    Args:
        mean: mean of the old policy in the states, shape (batch, n).
        before: variance of the old policy in the states, shape (batch, n).
        new: the new policy.
        observations: the states, shape (batch, d).
    """
    after, squares = new.variance(observations), (mean - new.mean(observations)) ** 2
    terms = np.log(after / before) + (before + squares) / after - 1.0
    return float(0.5 * terms.sum(axis=1).mean())


class Acting:
    """A policy that acts in one batch of episodes.

    It must be called for each step in order. Owns the window of past steps, and the actions that are held.

    Args:
        policy: the policy for the whole batch.
        batch: the episodes.
        explore: whether actions are sampled; otherwise they are the mean.

    Attributes:
        points: inputs of the last decision, shape (num_envs, input_dim).
    """

    points: Array

    def __init__(self, policy: GaussianPolicy, batch: Batch, *, explore: bool) -> None:
        self.policy = policy
        self.batch = batch
        self._explore = explore
        mean, variance = policy.mean, policy.variance
        numbers = batch.num_envs * max(batch.horizon * mean.output_dim, *mean.centres.shape)
        require(numbers <= MOST_NUMBERS, "batch", f"at most {MOST_NUMBERS} numbers", numbers)
        self._mean = mean.prepared()
        self._constant_sd = np.sqrt(variance.values) if isinstance(variance, ConstantVariance) else None
        self._window = Window(policy.inputs, mean.output_dim)
        self._held = np.zeros((batch.num_envs, mean.output_dim))

    def __call__(self, step: int, observations: Array) -> Array:
        """Return the actions of a step, shape (num_envs, n), for observations of shape (num_envs, d).

        Raises:
            ValueError: the observations do not match the policy's inputs.
            RunError: an action is not finite.
        """
        if step % self.policy.action_repeat == 0:
            self.points = self._window.observed(observations)
            size = self.policy.mean.input_dim
            require(self.points.shape[1] == size, "points", f"{size} columns", self.points.shape[1])
            self._held = self._act(step, self.points)
            self._window.acted(self._held)
        return self._held.copy()

    @np.errstate(over="ignore", invalid="ignore")  # the check below reports environment and step
    def _act(self, step: int, points: Array) -> Array:
        actions = self._mean(points)
        if self._explore:
            noise = self._exploration[:, step // self.policy.action_repeat]
            actions += noise if self._constant_sd is not None else np.sqrt(self.policy.variance(points)) * noise
        if not all_finite(actions):
            row = int(np.isfinite(actions).all(axis=1).argmin())
            raise RunError(
                f"the policy's action in environment {row}, step {step + 1}: "
                f"expected finite numbers, got {truncated(actions[row])}"
            )
        return actions

    @cached_property
    def _exploration(self) -> Array:
        """The noise of the whole batch, scaled by the standard deviation if it is constant.

        It is drawn on first use, after the observations were checked.
        """
        draws = self.policy.exploration(self.batch)
        return draws if self._constant_sd is None else self._constant_sd * draws
