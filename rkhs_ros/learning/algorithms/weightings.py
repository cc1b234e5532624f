"""Weightings of the exploration in PoWER: how much each step counts in the next policy."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from rkhs_ros.learning.algorithms.critics import ValueBaseline
from rkhs_ros.learning.samples import Samples
from rkhs_ros.rkhs.kernels import Array

Weighting = Callable[[Samples, float, ValueBaseline], Array]


def positive(samples: Samples, discount: float, baseline: ValueBaseline) -> Array:
    r"""Return :math:`q = \max(A, 0)`: what went worse than expected does not count."""
    return np.maximum(baseline.advantages(samples, discount), 0.0)


def shifted(samples: Samples, discount: float, baseline: ValueBaseline) -> Array:
    """Return the advantage less the least one at the same step of all episodes."""
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
    """Return the reward to go, as Kober and Peters (2011) do; rewards are taken to be positive."""
    return np.maximum(samples.rewards_to_go(discount), 0.0)


WEIGHTINGS: dict[str, Weighting] = {
    "positive": positive,
    "shifted": shifted,
    "exponential": exponential,
    "returns": returns,
}


def normalised(weights: Array) -> Array:
    """Return the weights with mean 1, so that a ridge means the same whatever the rewards' units."""
    mean = weights.mean()
    return weights / mean if mean > 0 else np.ones_like(weights)
