"""The best and the last policy of a run in fresh episodes, by which neither of them was chosen."""

from dataclasses import dataclass

import numpy as np

from rkhs_ros.base.threads import one_thread
from rkhs_ros.learning.training import Runner
from rkhs_ros.learning.training_settings import Training
from rkhs_ros.policies.gaussian import GaussianPolicy
from rkhs_ros.policies.streams import Batch, stream_seed
from rkhs_ros.rkhs.kernels import Array

BATCHES = 4  # fresh episodes of each policy, in multiples of the evaluation episodes


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
        if self.last is self.best:
            return f"best policy, which is the last one, {_mean(self.best)} {count}"
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
    return f"{returns.mean():.4g} \u00b1 {returns.std(ddof=1) / np.sqrt(len(returns)):.2g}"
