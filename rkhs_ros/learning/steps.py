"""Step rules: how far to go along a direction of policy space."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rkhs_ros.rkhs.kernels import Array
from rkhs_ros.rkhs.settings import setting


@dataclass(frozen=True)
class FixedStep:
    """The same step size at every iteration."""

    size: float = setting(0.1, "step size along the direction", minimum=0.0, maximum=1e6)

    def step_size(self, direction: Array, variance: Array) -> float:
        """Return the step size."""
        return self.size


@dataclass(frozen=True)
class KLStep:
    r"""The step at which the policies before and after differ by a given Kullback-Leibler divergence (Eq 15).

    .. math:: \alpha = \min\Big(cap, \sqrt{2 \delta \Big/ \tfrac1n \textstyle\sum_t |w(s_t) / \sigma(s_t)|^2}\Big)
    """

    divergence: float = setting(0.02, "mean divergence of an update, in nats", minimum=0.0, maximum=10.0)
    cap: float = setting(1.0, "largest step size", minimum=0.0, maximum=1e6)

    def step_size(self, direction: Array, variance: Array) -> float:
        """Return the step size for a direction, shape (samples, n), under a variance of that shape."""
        square = float(np.mean(np.sum(direction**2 / variance, axis=1)))
        return min(self.cap, float(np.sqrt(2.0 * self.divergence / square))) if square > 0 else 0.0


StepRule = FixedStep | KLStep
STEP_RULES: dict[str, type] = {"fixed": FixedStep, "kl": KLStep}
