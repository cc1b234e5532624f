"""The base class of all algorithms: an update computes the next policy from a policy and its episodes."""

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from rkhs_ros.base.settings import Settings, setting
from rkhs_ros.base.validation import require
from rkhs_ros.learning.algorithms.step_rules import StepRule
from rkhs_ros.learning.episodes import Episodes
from rkhs_ros.learning.samples import Samples
from rkhs_ros.policies.gaussian import GaussianPolicy, mean_kl
from rkhs_ros.policies.variance import ConstantVariance
from rkhs_ros.rkhs.function import Function
from rkhs_ros.rkhs.kernels import Array, Kernel

LEARNT_SD = 0.01, 10.0  # bounds of a learnt standard deviation, relative to the first one


@dataclass(frozen=True)
class Metrics:
    """Measurements of one update.

    Attributes:
        step_size: step size of the mean along the direction.
        kl: mean KL divergence from the old to the new policy over the samples, in nats.
        centres: number of centres of the new mean.
        sparsification_error: relative error of the sparsified mean at the samples.
    """

    step_size: float
    kl: float
    centres: int
    sparsification_error: float


@dataclass(frozen=True)
class Experience:
    """The data of an update; the observations of its episodes are the policy's inputs.

    Attributes:
        episodes: exploration episodes of the policy, N at least 1.
        discount: discount factor of the return.
        memory: earlier episodes that the algorithm reuses; empty at first.
        collect: runs a number of new exploration episodes with a policy; they count as episodes used.
        first_variance: variance of the first policy, shape (n,); it determines the bounds of a learnt variance.
        iteration: number of previous updates.
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
        metrics: measurements of the update.
    """

    policy: GaussianPolicy
    metrics: Metrics


@dataclass(frozen=True)
class Algorithm(Settings, ABC):
    """A policy search in function space; each subclass is one algorithm, its fields are the hyper-parameters."""

    exploration_decay: float = setting(
        1.0,
        "factor on the standard deviation after each iteration without a model, if it is not learnt",
        minimum=0.0,
        maximum=1.0,
    )
    sd_range: tuple[float, ...] = setting(
        (0.05, 4.0),
        "minimum of a decaying standard deviation, and bounds of one that depends on the state, in units of the action",
        minimum=1e-6,
        maximum=1e6,
    )

    def __post_init__(self) -> None:
        """Raise ValueError if a value is invalid or the bounds of the standard deviation are swapped."""
        super().__post_init__()
        good = len(self.sd_range) == 2 and self.sd_range[0] <= self.sd_range[1]
        require(good, "algorithm.sd_range", "a minimum and a maximum", self.sd_range)

    @abstractmethod
    def samples(self, policy: GaussianPolicy, episodes: Episodes) -> Samples:
        """Return the steps of episodes in coordinates of the space of functions that is searched."""

    @abstractmethod
    def move(self, policy: GaussianPolicy, direction: Function, points: Array) -> tuple[GaussianPolicy, float]:
        """Return the policy with the direction added to its mean; see `Sparse` and `Grid`."""

    @property
    def learns_variance(self) -> bool:
        """Whether an update learns the policy's variance; otherwise the variance decays."""
        return False

    def check_kernel(self, kernel: Kernel) -> None:  # most algorithms support all kernels
        """Raise ValueError if the algorithm does not support the kernel."""

    @abstractmethod
    def update(self, policy: GaussianPolicy, experience: Experience) -> Update:
        """Return the next policy.

        Args:
            policy: the policy that acted in the episodes.
            experience: the episodes and further data of the update.
        """

    def remembered(self, episodes: Episodes, discount: float) -> Episodes:
        """Return the episodes that the next update reuses, by default none.

        Args:
            episodes: the episodes of an update, followed by those that it reused.
            discount: discount factor of the return.
        """
        return episodes.take(slice(0))

    def gradient_step(
        self,
        policy: GaussianPolicy,
        coefficients: Array,
        samples: Samples,
        experience: Experience,
        step: StepRule,
        spread: Array | None = None,
    ) -> Update:
        r"""Return the policy after a step along a direction, :math:`h \leftarrow h + \alpha w`, and its variance decay.

        If a direction v of the variance is given, the variance takes the same step instead of decaying:
        :math:`\sqrt2 \log\sigma \leftarrow \sqrt2 \log\sigma + \alpha v`.

        Args:
            policy: the policy.
            coefficients: coefficients of the direction w in the basis of the samples, shape (m, n).
            samples: the policy's samples.
            experience: the data of the update; line searches use it to collect episodes.
            step: step rule.
            spread: v, shape (n,).
        """
        w = samples.basis.function(coefficients)

        def mean_return(size: float, episodes: int) -> float:
            tried = policy.with_mean(policy.mean + w.scale(size))  # only the selected step is sparsified
            return float(experience.collect(tried, episodes).returns(experience.discount).mean())

        direction, variance = samples.features @ coefficients, samples.variance
        if spread is not None:  # in its units, the divergence equals that of an action of variance 1
            direction = np.hstack([direction, np.tile(spread, (len(direction), 1))])
            variance = np.hstack([variance, np.ones_like(variance)])
        alpha = step.step_size(direction, variance, mean_return, experience.iteration)
        moved, error = self.move(policy, w.scale(alpha), samples.observations)
        new = replace(
            moved, variance=self.decayed(policy) if spread is None else _moved(policy, alpha * spread, experience)
        )
        return Update(new, measure(samples, new, alpha, error))

    def decayed(self, policy: GaussianPolicy) -> ConstantVariance:
        """Return the decayed variance of the next policy.

        Raises:
            ValueError: the variance depends on the state.
        """
        return _constant_variance(policy).decay(self.exploration_decay, self.sd_range[0])


def _constant_variance(policy: GaussianPolicy) -> ConstantVariance:
    if not isinstance(policy.variance, ConstantVariance):
        raise ValueError("variance: expected a constant variance, got one that depends on the state")
    return policy.variance


def _moved(policy: GaussianPolicy, step: Array, experience: Experience) -> ConstantVariance:
    least, most = (part**2 * experience.first_variance for part in LEARNT_SD)
    return _constant_variance(policy).moved(step, least, most)


def measure(samples: Samples, new: GaussianPolicy, step_size: float, sparsification_error: float) -> Metrics:
    """Return the metrics of an update over its samples."""
    kl = mean_kl(samples.mean, samples.variance, new, samples.observations)
    return Metrics(step_size, kl, len(new.mean.centres), sparsification_error)
