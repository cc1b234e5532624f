"""Weightings of the exploration in PoWER: the weight of each step in the update."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from rkhs_ros.learning.algorithms.critics import ValueBaseline
from rkhs_ros.learning.samples import Samples
from rkhs_ros.rkhs.kernels import Array

Weighting = Callable[[Samples, float, ValueBaseline], Array]


def positive(samples: Samples, discount: float, baseline: ValueBaseline) -> Array:
    r"""Return :math:`q = \max(A, 0)`, which ignores steps that were worse than expected."""
    return np.maximum(baseline.advantages(samples, discount), 0.0)


def shifted(samples: Samples, discount: float, baseline: ValueBaseline) -> Array:
    """Return the advantage minus the smallest one at the same step of all episodes."""
    advantage = baseline.advantages(samples, discount)
    least = np.full(samples.episodes.horizon, np.inf)
    np.minimum.at(least, samples.episodes.steps, advantage)
    return np.asarray(advantage - least[samples.episodes.steps])


def exponential(samples: Samples, discount: float, baseline: ValueBaseline) -> Array:
    r"""Return :math:`\exp(A / \mathrm{sd}(A))`."""
    advantage = baseline.advantages(samples, discount)
    deviation = advantage.std()
    return np.exp((advantage - advantage.max()) / deviation) if deviation > 0 else np.ones_like(advantage)


def returns(samples: Samples, discount: float, baseline: ValueBaseline) -> Array:
    """Return the rewards to go, like Kober and Peters (2011); rewards should be positive."""
    return np.maximum(samples.rewards_to_go(discount), 0.0)


WEIGHTINGS: dict[str, Weighting] = {
    "positive": positive,
    "shifted": shifted,
    "exponential": exponential,
    "returns": returns,
}


def normalised(weights: Array) -> Array:
    """Return the weights scaled to mean 1, so that the effect of a ridge does not depend on the rewards' units."""
    mean = weights.mean()
    return weights / mean if mean > 0 else np.ones_like(weights)
