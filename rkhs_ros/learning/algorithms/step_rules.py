"""Step rules: the size of a step along a direction in policy space."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from rkhs_ros.base.settings import Settings, setting
from rkhs_ros.rkhs.kernels import Array

SHORTEST, LONGEST = 0.01, 3.0  # steps of the line search, in standard deviations of the action
TRIED = 50  # steps of a line search
MeanReturn = Callable[[float, int], float]  # from a step size and a number of new episodes to their mean return


@dataclass(frozen=True)
class FixedStep(Settings):
    """A constant step size."""

    size: float = setting(0.1, "step size along the direction", minimum=0.0, maximum=1e6)

    def step_size(self, direction: Array, variance: Array, mean_return: MeanReturn, iteration: int = 0) -> float:
        """Return the constant step size."""
        return self.size


@dataclass(frozen=True)
class KLStep(Settings):
    r"""The step size with a given Kullback-Leibler divergence between the old and the new policy (Eq 15).

    .. math:: \alpha = \min\Big(size, \sqrt{2 \delta \Big/ \tfrac1n \textstyle\sum_t |w(s_t) / \sigma(s_t)|^2}\Big),
        \qquad \delta = \delta_0 / (1 + c k)

    Once w is mostly noise, steps of constant length become a random walk. Annealing (c > 0) ends this walk.
    """

    divergence: float = setting(0.05, "mean divergence of the first update, in nats", minimum=0.0, maximum=10.0)
    size: float = setting(1e300, "maximum step size along the direction", minimum=0.0, maximum=1e300)
    annealing: float = setting(
        0.0,
        "annealing rate c: iteration k, or update k in a model, divides the divergence by 1 + c k",
        minimum=0.0,
        maximum=1e6,
    )

    def step_size(self, direction: Array, variance: Array, mean_return: MeanReturn, iteration: int = 0) -> float:
        """Return the step size for a direction and a variance, both of shape (samples, n)."""
        length = _length(direction, variance)
        divergence = self.divergence / (1.0 + self.annealing * iteration)
        return min(self.size, float(np.sqrt(2.0 * divergence)) / length) if length > 0 else 0.0


@dataclass(frozen=True)
class LineSearch(Settings):
    """The best of several step sizes, each evaluated in a new episode (section 4.1 of the paper).

    The 50 step lengths are evenly spaced on a logarithmic scale. They are in standard deviations of the action, root
    mean square over the samples, so that their range suits any direction.
    """

    def step_size(self, direction: Array, variance: Array, mean_return: MeanReturn, iteration: int = 0) -> float:
        """Return the step size with the greatest mean return.

        Args:
            direction: direction at the samples, shape (samples, n).
            variance: variance of the policy at the samples, shape (samples, n).
            mean_return: runs a number of new episodes with a step size and returns their mean return.
            iteration: number of previous updates.
        """
        length = _length(direction, variance)
        if length == 0:
            return 0.0
        sizes = np.geomspace(SHORTEST, LONGEST, TRIED) / length
        return float(max(sizes, key=lambda size: mean_return(float(size), 1)))


def _length(direction: Array, variance: Array) -> float:
    """Return the root mean square length of a direction, in standard deviations of the action."""
    return float(np.sqrt(np.mean(np.sum(direction**2 / variance, axis=1))))


StepRule = FixedStep | KLStep | LineSearch
STEP_RULES: dict[str, type] = {"fixed": FixedStep, "kl": KLStep, "line_search": LineSearch}
