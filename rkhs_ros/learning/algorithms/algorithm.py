"""The base of all algorithms: an update makes the next policy from a policy and its episodes."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from rkhs_ros.base.settings import Settings, setting
from rkhs_ros.learning.algorithms.function_spaces import FunctionSpace
from rkhs_ros.learning.algorithms.step_rules import StepRule
from rkhs_ros.learning.episodes import Episodes
from rkhs_ros.learning.samples import Samples
from rkhs_ros.policies.gaussian import GaussianPolicy, mean_kl
from rkhs_ros.policies.variance import ConstantVariance
from rkhs_ros.rkhs.kernels import Array, Kernel

LEARNT_SD = 0.01, 10.0  # parts of the first standard deviation between which one is learnt


@dataclass(frozen=True)
class Metrics:
    """Measurements of one update.

    Attributes:
        step_size: how far the mean went along the direction.
        kl: mean divergence of the policies before and after, over the samples, in nats.
        centres: number of centres of the new mean.
        sparsification_error: relative error of thinning the new mean out, at the samples.
    """

    step_size: float
    kl: float
    centres: int
    sparsification_error: float


@dataclass(frozen=True)
class Experience:
    """What an update learns from. The episodes' observations are the policy's inputs.

    Attributes:
        episodes: exploring episodes of the policy, N at least 1.
        discount: discount factor of the return.
        memory: earlier episodes that the algorithm asked to keep; none at first.
        collect: makes a number of fresh exploring episodes with a policy; they count as episodes used.
        first_variance: of the first policy, shape (n,), which bounds one that is learnt.
        iteration: number of updates before this one.
    """

    episodes: Episodes
    discount: float
    memory: Episodes
    collect: Callable[[GaussianPolicy, int], Episodes]
    first_variance: Array
    iteration: int = 0


class Update(NamedTuple):
    """The result of an update.

    Attributes:
        policy: the next policy.
        metrics: what the update did.
        memory: episodes to keep for the next update.
    """

    policy: GaussianPolicy
    metrics: Metrics
    memory: Episodes


@dataclass(frozen=True)
class Algorithm(Settings, ABC):
    """Policy search by functions; a subclass is one algorithm and its fields are the hyper-parameters."""

    exploration_decay: float = setting(
        1.0, "factor on a constant standard deviation each iteration", minimum=0.0, maximum=1.0
    )
    exploration_minimum: float = setting(0.05, "standard deviation not decayed below", minimum=1e-6, maximum=1e6)

    @property
    @abstractmethod
    def space(self) -> FunctionSpace:
        """The space searched, made from the settings: see `SparseSettings` and `GridSettings`."""

    @property
    def learns_variance(self) -> bool:
        """Whether an update sets the policy's variance by what was seen; else it decays."""
        return False

    def check_kernel(self, kernel: Kernel) -> None:  # most algorithms take any
        """Raise ValueError where the algorithm cannot learn with this kernel."""

    @abstractmethod
    def update(self, policy: GaussianPolicy, experience: Experience) -> Update:
        """Return the next policy.

        Args:
            policy: the policy that acted in the episodes.
            experience: what it saw, did and earned.
        """

    def gradient_step(
        self,
        policy: GaussianPolicy,
        coefficients: Array,
        samples: Samples,
        experience: Experience,
        step: StepRule,
        spread: Array | None = None,
    ) -> Update:
        r"""Return the policy a step along a direction, :math:`h \leftarrow h + \alpha w`, its variance decayed.

        With a direction v of the variance, too, that goes along instead, by the same step:
        :math:`\sqrt2 \log\sigma \leftarrow \sqrt2 \log\sigma + \alpha v`.

        Args:
            policy: the policy.
            coefficients: of the direction w, shape (m, n).
            samples: the policy's samples, in whose basis the coefficients are.
            experience: for the step rules that try steps out.
            step: how far to go.
            spread: v, shape (n,).
        """
        w = samples.basis.function(coefficients)

        def mean_return(size: float, episodes: int) -> float:
            tried = policy.with_mean(policy.mean + w.scale(size))  # thinned out only once it is chosen
            return float(experience.collect(tried, episodes).returns(experience.discount).mean())

        direction, variance = samples.features @ coefficients, samples.variance
        if spread is not None:  # it is in units in which a policy's divergence is that of an action's of variance 1
            direction = np.hstack([direction, np.tile(spread, (len(direction), 1))])
            variance = np.hstack([variance, np.ones_like(variance)])
        alpha = step.step_size(direction, variance, mean_return, experience.iteration)
        moved, error = self.space.move(policy, w.scale(alpha), samples.observations)
        new = replace(
            moved, variance=self.decayed(policy) if spread is None else _moved(policy, alpha * spread, experience)
        )
        return Update(new, measure(samples, new, alpha, error), experience.memory)

    def decayed(self, policy: GaussianPolicy) -> ConstantVariance:
        """Return the variance of the next policy.

        Raises:
            ValueError: it depends on the state.
        """
        return _constant_variance(policy).decay(self.exploration_decay, self.exploration_minimum)


def _constant_variance(policy: GaussianPolicy) -> ConstantVariance:
    """Return the variance of a policy.

    Raises:
        ValueError: it depends on the state.
    """
    if not isinstance(policy.variance, ConstantVariance):
        raise ValueError("variance: expected a constant one to change, got one that depends on the state")
    return policy.variance


def _moved(policy: GaussianPolicy, step: Array, experience: Experience) -> ConstantVariance:
    least, most = (part**2 * experience.first_variance for part in LEARNT_SD)
    return _constant_variance(policy).moved(step, least, most)


def measure(samples: Samples, new: GaussianPolicy, step_size: float, sparsification_error: float) -> Metrics:
    """Return the metrics of an update over the points visited."""
    kl = mean_kl(samples.mean, samples.variance, new, samples.observations)
    return Metrics(step_size, kl, len(new.mean.centres), sparsification_error)
