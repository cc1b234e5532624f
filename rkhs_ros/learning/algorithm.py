"""What every algorithm is: hyper-parameters, and an update from policy and episodes to the next policy."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass

import numpy as np

from rkhs_ros.learning.episodes import Episodes
from rkhs_ros.policies.gaussian import GaussianPolicy, mean_kl
from rkhs_ros.rkhs.function import Function
from rkhs_ros.rkhs.kernels import Array
from rkhs_ros.rkhs.pursuit import sparsify
from rkhs_ros.rkhs.settings import setting


@dataclass(frozen=True)
class Metrics:
    """What an update did.

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
class Algorithm(ABC):
    """Policy search by functions; a subclass is one algorithm and its fields are the hyper-parameters."""

    centres: int = setting(40, "number of centres of the policy at most", minimum=1, maximum=2000)
    sparsification_tolerance: float = setting(
        0.0, "relative error at which fewer centres are enough", minimum=0.0, maximum=1.0
    )

    @abstractmethod
    def update(self, policy: GaussianPolicy, episodes: Episodes, discount: float) -> tuple[GaussianPolicy, Metrics]:
        """Return the next policy.

        Args:
            policy: the policy that acted in the episodes.
            episodes: its exploring episodes.
            discount: discount factor of the return.
        """

    def move(self, policy: GaussianPolicy, direction: Function, points: Array) -> tuple[GaussianPolicy, float]:
        """Return the policy with the direction added to its mean, sparsified, and the relative error of that."""
        fit = sparsify(policy.mean + direction, points, budget=self.centres, tolerance=self.sparsification_tolerance)
        return policy.with_mean(fit.function), fit.error


def measure(
    old: GaussianPolicy, new: GaussianPolicy, points: Array, step_size: float, sparsification_error: float
) -> Metrics:
    """Return the metrics of an update over the points visited."""
    return Metrics(step_size, mean_kl(old, new, points), len(np.asarray(new.mean.centres)), sparsification_error)
