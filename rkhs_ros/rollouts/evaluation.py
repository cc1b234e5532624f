"""Returns of a policy in evaluation episodes, with their statistics."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rkhs_ros.learning.episodes import Episodes
from rkhs_ros.rkhs.kernels import Array

CONFIDENCE = 0.95


@dataclass(frozen=True, eq=False)
class Evaluation:
    """Returns of a policy in evaluation episodes.

    Attributes:
        environment: name of the environment.
        seed: seed of the episodes.
        discount: discount factor of the discounted return, per step.
        discounted_returns: discounted return of each episode, shape (episodes,).
        undiscounted_returns: sum of the rewards of each episode, shape (episodes,).
    """

    environment: str
    seed: int
    discount: float
    discounted_returns: Array
    undiscounted_returns: Array

    @classmethod
    def of(cls, episodes: Episodes, environment: str, seed: int, discount: float) -> Evaluation:
        """Return the returns of episodes."""
        return cls(environment, seed, discount, episodes.returns(discount), episodes.returns(1.0))

    @property
    def discounted_return(self) -> float:
        """Mean discounted return."""
        return float(self.discounted_returns.mean())

    @property
    def undiscounted_return(self) -> float:
        """Mean undiscounted return."""
        return float(self.undiscounted_returns.mean())

    def __repr__(self) -> str:
        """Return the mean returns in one line."""
        returns = f"discounted return {self.discounted_return:.4g}, undiscounted return {self.undiscounted_return:.4g}"
        return f"<Evaluation of {len(self.discounted_returns)} episodes in {self.environment}: {returns}>"

    def statistics(self) -> dict[str, object]:
        """Return the statistics that ``rkhs evaluate`` prints, ready for JSON."""
        return {
            "environment": self.environment,
            "episodes": len(self.discounted_returns),
            "seed": self.seed,
            "discount": self.discount,
            **_measured(self.discounted_returns),
            "undiscounted": _measured(self.undiscounted_returns),
        }


def _measured(returns: Array) -> dict[str, object]:
    """Return mean, standard deviation, and Student's t interval of the mean, which is None for one episode."""
    from scipy import stats  # here, since the import takes a second

    mean, interval = float(returns.mean()), None
    if len(returns) > 1:
        half = float(stats.t.ppf(0.5 + CONFIDENCE / 2, len(returns) - 1) * stats.sem(returns))
        interval = [mean - half, mean + half]
    return {"mean": mean, "sd": float(np.std(returns)), "interval_95": interval}
