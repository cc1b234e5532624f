"""Returns of a policy in evaluation episodes with their statistics, and the fresh episodes at the end of a run."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rkhs_ros.base.processes import one_thread
from rkhs_ros.learning.episodes import Episodes
from rkhs_ros.learning.iteration import standard_error, with_error
from rkhs_ros.learning.training import Runner
from rkhs_ros.learning.training_settings import Training
from rkhs_ros.policies.gaussian import GaussianPolicy
from rkhs_ros.policies.streams import Batch, stream_seed
from rkhs_ros.rkhs.kernels import Array

BATCHES = 4  # fresh episodes of each policy, in multiples of the evaluation episodes
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


@dataclass(frozen=True, eq=False)
class FinalEvaluation:
    """Discounted returns of two policies in the same fresh episodes.

    Attributes:
        best: returns of the policy with the greatest evaluation return minus its standard error, shape (episodes,).
        last: returns of the last policy; those of ``best`` if it is the same policy.
    """

    best: Array
    last: Array

    @property
    def last_is_better(self) -> bool:
        """Whether the last policy has the greater mean return."""
        return bool(self.last.mean() > self.best.mean())

    def __str__(self) -> str:
        """Return both mean returns with their standard errors in one line."""
        count = f"in {len(self.best)} fresh episodes"
        if np.array_equal(self.last, self.best):
            return f"best and last policy {_mean(self.best)} {count}"
        kept = "last" if self.last_is_better else "best"
        both = f"best policy {_mean(self.best)}, last policy {_mean(self.last)}"
        return f"{both} {count}; kept the {kept} policy"


def final_evaluation(training: Training, runner: Runner, best: GaussianPolicy, last: GaussianPolicy) -> FinalEvaluation:
    """Run the best and the last policy of a run in fresh episodes, which have random streams of their own."""
    seed, count = stream_seed(training.seed, "final evaluation", 0), training.evaluation_episodes
    batches = [Batch(seed, n * count, count, training.horizon, explore=False) for n in range(BATCHES)]

    def returns(policy: GaussianPolicy) -> Array:
        return np.concatenate([runner.collect(policy, batch).returns(training.discount) for batch in batches])

    with one_thread():
        of_best = returns(best)
        return FinalEvaluation(of_best, of_best if last is best else returns(last))


def _mean(returns: Array) -> str:
    return with_error(float(returns.mean()), standard_error(float(returns.std()), len(returns)))
