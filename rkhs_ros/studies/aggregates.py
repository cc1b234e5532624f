"""What the returns of several runs come to, with intervals over the runs.

The measures, and the bootstrap, are those of Agarwal et al. (2021), "Deep Reinforcement Learning at the Edge of the
Statistical Precipice". Strata are the ways to learn: each one's runs are drawn among themselves.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from scipy.integrate import trapezoid

from rkhs_ros.rkhs.kernels import Array

CONFIDENCE = 0.95
RESAMPLES = 10_000
BATCH_NUMBERS = 10**7  # drawn at once
SEED = 0
Statistic = Callable[..., Any]


class Estimate(NamedTuple):
    """A number with its 95 % interval; numbers, or arrays of one shape. Of a single run the interval is nan."""

    value: Any
    low: Any
    high: Any

    def __str__(self) -> str:
        """Return it as text, with its interval where there is one."""
        interval = "" if np.isnan(self.low) else f" [{self.low:.5g}, {self.high:.5g}]"
        return f"{self.value:.5g}{interval}"


@dataclass(frozen=True)
class Aggregates:
    """What the runs of a learning curve come to.

    Attributes:
        final: mean return at the end.
        best: mean over the runs of the greatest return of each.
        interquartile_mean: of the returns at the end.
        median: of the returns at the end.
        area_under_curve: mean return over the exploring episodes, from the first evaluation to the last.
    """

    final: Estimate
    best: Estimate
    interquartile_mean: Estimate
    median: float
    area_under_curve: float


def aggregates(episodes: Array, returns: Array) -> Aggregates:
    """Return what runs come to.

    Args:
        episodes: exploring episodes used up to each iteration, shape (iterations,).
        returns: shape (runs, iterations).
    """
    final, span = returns[:, -1], episodes[-1] - episodes[0]
    areas = trapezoid(returns, episodes) / span if span > 0 else final
    return Aggregates(
        final=mean_over_runs(final),
        best=mean_over_runs(returns.max(axis=1)),
        interquartile_mean=_estimate(_interquartile_mean, final),
        median=float(np.median(final)),
        area_under_curve=float(np.mean(areas)),
    )


def mean_over_runs(values: Array) -> Estimate:
    """Return the mean over the first axis, the runs."""
    return _estimate(np.mean, values)


def median_over_runs(values: Array) -> Estimate:
    """Return the median over the first axis, the runs."""
    return _estimate(np.median, values)


def _interquartile_mean(values: Array, axis: int) -> Any:
    from scipy.stats import trim_mean  # here, since it takes a second to import, and few need it

    return trim_mean(values, 0.25, axis=axis)


def _estimate(statistic: Statistic, values: Array) -> Estimate:
    """Return a statistic with its percentile bootstrap interval; the same draws each time."""
    value = statistic(values, axis=0)
    if len(values) == 1:
        return Estimate(value, value * np.nan, value * np.nan)
    from scipy.stats import bootstrap

    interval = bootstrap(
        (values,),
        statistic,
        n_resamples=RESAMPLES,
        batch=max(BATCH_NUMBERS // values.size, 1),
        confidence_level=CONFIDENCE,
        method="percentile",
        random_state=np.random.default_rng(SEED),  # in scipy 1.15 and later also called rng
    ).confidence_interval
    return Estimate(value, interval.low, interval.high)
