"""Statistics of the evaluation episodes of a policy."""

from __future__ import annotations

import numpy as np

from rkhs_ros.learning.episodes import Episodes
from rkhs_ros.rkhs.kernels import Array

CONFIDENCE = 0.95


def evaluation_of(episodes: Episodes, environment: str, seed: int, discount: float) -> dict[str, object]:
    """Return the statistics of the discounted and the undiscounted return of episodes, ready for JSON."""
    return {
        "environment": environment,
        "episodes": len(episodes),
        "seed": seed,
        "discount": discount,
        **_measured(episodes.returns(discount)),
        "undiscounted": _measured(episodes.returns(1.0)),
    }


def _measured(returns: Array) -> dict[str, object]:
    """Return mean, standard deviation, and Student's t interval of the mean, which is None for one episode."""
    from scipy import stats  # here, since the import takes a second

    mean, interval = float(returns.mean()), None
    if len(returns) > 1:
        half = float(stats.t.ppf(0.5 + CONFIDENCE / 2, len(returns) - 1) * stats.sem(returns))
        interval = [mean - half, mean + half]
    return {"mean": mean, "sd": float(np.std(returns)), "interval_95": interval}
