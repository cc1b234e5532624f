"""Step rules: how far to go along a direction of policy space."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from rkhs_ros.base.settings import Settings, setting
from rkhs_ros.rkhs.kernels import Array

MeanReturn = Callable[[float, int], float]  # of a step size, in a number of fresh episodes


@dataclass(frozen=True)
class FixedStep(Settings):
    """The same step size at every iteration."""

    size: float = setting(0.1, "step size along the direction", minimum=0.0, maximum=1e6)

    def step_size(self, direction: Array, variance: Array, mean_return: MeanReturn, iteration: int = 0) -> float:
        """Return the step size."""
        return self.size


@dataclass(frozen=True)
class KLStep(Settings):
    r"""The step at which the policies before and after differ by a given Kullback-Leibler divergence (Eq 15).

    .. math:: \alpha = \min\Big(cap, \sqrt{2 \delta \Big/ \tfrac1n \textstyle\sum_t |w(s_t) / \sigma(s_t)|^2}\Big),
        \qquad \delta = \delta_0 / (1 + c k)

    Annealing by c over the iterations k ends the random walk of steps of one length when w is but noise.
    """

    divergence: float = setting(0.02, "mean divergence of the first update, in nats", minimum=0.0, maximum=10.0)
    cap: float = setting(1e300, "largest step size; it has the units of the direction", minimum=0.0, maximum=1e300)
    annealing: float = setting(
        0.0, "c of the divergence's decrease with the iterations, by 1 / (1 + c k)", minimum=0.0, maximum=1e6
    )

    def step_size(self, direction: Array, variance: Array, mean_return: MeanReturn, iteration: int = 0) -> float:
        """Return the step size for a direction, shape (samples, n), under a variance of that shape."""
        length = _length(direction, variance)
        divergence = self.divergence / (1.0 + self.annealing * iteration)
        return min(self.cap, float(np.sqrt(2.0 * divergence)) / length) if length > 0 else 0.0


@dataclass(frozen=True)
class LineSearch(Settings):
    """The best of a grid of steps (section 4.1 of the paper), each tried out in fresh episodes.

    The steps are spaced evenly in logarithm. Their lengths are in standard deviations of the action, root mean
    square over the samples, so that the grid suits any direction.
    """

    choices: int = setting(50, "number of steps tried out", minimum=2, maximum=1000)
    episodes: int = setting(1, "exploring episodes for each of them", minimum=1, maximum=1000)
    shortest: float = setting(0.01, "shortest step, in standard deviations of the action", minimum=1e-9, maximum=1e6)
    longest: float = setting(3.0, "longest step, in standard deviations of the action", minimum=1e-9, maximum=1e6)

    def step_size(self, direction: Array, variance: Array, mean_return: MeanReturn, iteration: int = 0) -> float:
        """Return the step size with the greatest mean return.

        Args:
            direction: at the samples, shape (samples, n).
            variance: of the policy there, shape (samples, n).
            mean_return: lets a step size act in a number of fresh episodes and gives their mean return.
            iteration: number of updates before this one.
        """
        length = _length(direction, variance)
        if length == 0:
            return 0.0
        sizes = np.geomspace(self.shortest, self.longest, self.choices) / length
        return float(max(sizes, key=lambda size: mean_return(float(size), self.episodes)))


def _length(direction: Array, variance: Array) -> float:
    """Return the root mean square length of a direction, in standard deviations of the action."""
    return float(np.sqrt(np.mean(np.sum(direction**2 / variance, axis=1))))


StepRule = FixedStep | KLStep | LineSearch
STEP_RULES: dict[str, type] = {"fixed": FixedStep, "kl": KLStep, "line_search": LineSearch}
