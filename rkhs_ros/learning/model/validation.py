"""Choose the best policy of the training in a model by rollouts that are the same for all candidates."""

from __future__ import annotations

import numpy as np

from rkhs_ros.learning.model.model_rollouts import ModelRunner
from rkhs_ros.policies.gaussian import GaussianPolicy
from rkhs_ros.policies.streams import Batch
from rkhs_ros.rkhs.kernels import Array

PATIENCE = 6  # candidates without improvement after which training ends


class Validation:
    """The best of the policies considered so far, by the mean return of rollouts of the policy mean.

    All policies are compared on the same rollouts: with the same functions drawn from the model, starts and noise. A
    policy is better if the differences of the returns exceed 0 by more than the standard error of their mean. Without
    this margin, an improvement by chance on these rollouts may lose starts that they do not include.

    Args:
        count: number of rollouts of each policy, at least 2.
        runner: runs the rollouts.
        seed: seed of their random streams.
        horizon: length of a rollout in steps.

    Attributes:
        best: the best policy; None if there is none.
    """

    def __init__(self, count: int, runner: ModelRunner, seed: int, horizon: int) -> None:
        self._runner = runner
        self._batch = Batch(seed, 0, count, horizon, explore=False)
        self._returns: Array = np.full(count, -np.inf)
        self._waited = 0
        self.best: GaussianPolicy | None = None

    @property
    def best_return(self) -> float:
        """Mean return of the best policy."""
        return float(self._returns.mean())

    @property
    def improves(self) -> bool:
        """Whether one of the last candidates was better than those before."""
        return self._waited < PATIENCE

    def consider(self, policy: GaussianPolicy, discount: float) -> None:
        """Compare a policy with the best one; a policy whose mean is 0, which has not been trained, is ignored."""
        if not policy.mean.weights.any():
            return
        returns = self._runner.collect(policy, self._batch).returns(discount)
        self._waited += 1
        if self.best is None or _exceeds(returns - self._returns):
            self.best, self._returns, self._waited = policy, returns, 0


def _exceeds(differences: Array) -> bool:
    """Return whether the mean of differences is above 0 by more than its standard error."""
    return bool(differences.mean() > differences.std() / np.sqrt(len(differences) - 1))
