"""Statistics of the returns of several runs, with confidence intervals over the runs.

The measures and the stratified bootstrap follow Agarwal et al. (2021), "Deep Reinforcement Learning at the Edge of the
Statistical Precipice". A stratum contains the runs with equal settings: the bootstrap resamples them separately.
"""

from collections.abc import Callable
from typing import Any, NamedTuple
from warnings import catch_warnings, simplefilter

import numpy as np
from scipy.integrate import trapezoid

from rkhs_ros.rkhs.kernels import Array

CONFIDENCE = 0.95
RESAMPLES = 10_000
BATCH_NUMBERS = 10**7  # drawn at once
SEED = 0


class Estimate(NamedTuple):
    """An estimate with its 95 % interval, as numbers or arrays of one shape; the interval of a single run is nan."""

    value: Any
    low: Any
    high: Any

    def __str__(self) -> str:
        """Return the estimate as text, with its interval unless this is nan."""
        interval = "" if np.isnan(self.low) else f" [{self.low:.5g}, {self.high:.5g}]"
        return f"{self.value:.5g}{interval}"


def aggregates(episodes: Array, returns: Array) -> dict[str, Any]:
    """Return statistics of the runs of a learning curve by name.

    Given are the number of exploration episodes up to each iteration, shape (iterations,), and the returns of each run,
    shape (runs, iterations).

    These are the means of the final returns and of the greatest return of each run, the interquartile mean and the
    median of the final returns, and the mean return over the exploration episodes, from the first evaluation to the
    last. The first three are estimates with intervals.
    """
    final, span = returns[:, -1], episodes[-1] - episodes[0]
    areas = trapezoid(returns, episodes) / span if span > 0 else final
    return {
        "final": mean_over_runs(final),
        "best": mean_over_runs(returns.max(axis=1)),
        "interquartile_mean": _estimate(_interquartile_mean, final),
        "median": float(np.median(final)),
        "area_under_curve": float(np.mean(areas)),
    }


def mean_over_runs(values: Array) -> Estimate:
    """Return the mean over the first axis, the runs."""
    return _estimate(np.mean, values)


def median_over_runs(values: Array) -> Estimate:
    """Return the median over the first axis, the runs."""
    return _estimate(np.median, values)


def _interquartile_mean(values: Array, axis: int) -> Any:
    from scipy.stats import trim_mean  # here, since the import takes a second

    return trim_mean(values, 0.25, axis=axis)


def _estimate(statistic: Callable[..., Any], values: Array) -> Estimate:
    """Return a statistic with its percentile bootstrap interval, which is deterministic."""
    value = statistic(values, axis=0)
    if len(values) == 1:
        return Estimate(value, value * np.nan, value * np.nan)
    from scipy.stats import DegenerateDataWarning, bootstrap

    with catch_warnings():
        simplefilter("ignore", DegenerateDataWarning)  # of runs with nan
        interval = bootstrap(
            (values,),
            statistic,
            n_resamples=RESAMPLES,
            batch=max(BATCH_NUMBERS // values.size, 1),
            confidence_level=CONFIDENCE,
            method="percentile",
            random_state=np.random.default_rng(SEED),  # scipy 1.15 and later also accept the name rng
        ).confidence_interval
    return Estimate(value, interval.low, interval.high)
