"""Choose the best policy of the training in a model by rollouts that are the same for all candidates."""

from __future__ import annotations

from rkhs_ros.learning.model.model_rollouts import ModelRunner
from rkhs_ros.policies.gaussian import GaussianPolicy
from rkhs_ros.policies.streams import Batch

PATIENCE = 6  # candidates without improvement after which training ends


class Validation:
    """The best of the policies considered so far, by the mean return of rollouts of the policy mean.

    All policies are compared on the same rollouts: with the same functions drawn from the model, starts and noise.

    Args:
        count: number of rollouts of each policy; 0 disables validation.
        runner: runs the rollouts.
        seed: seed of their random streams.
        horizon: length of a rollout in steps.

    Attributes:
        best: the best policy; None if there is none.
        highest: its mean return.
    """

    def __init__(self, count: int, runner: ModelRunner, seed: int, horizon: int) -> None:
        self._runner = runner
        self._batch = Batch(seed, 0, count, horizon, explore=False) if count else None
        self._waited = 0
        self.best: GaussianPolicy | None = None
        self.highest = float("-inf")

    @property
    def improves(self) -> bool:
        """Whether one of the last candidates was better than those before."""
        return self._batch is not None and self._waited < PATIENCE

    def consider(self, policy: GaussianPolicy, discount: float) -> None:
        """Compare a policy with the best one; a policy without centres, which has not been trained, is ignored."""
        if self._batch is None or len(policy.mean.centres) == 0:
            return
        value = float(self._runner.collect(policy, self._batch).returns(discount).mean())
        self._waited += 1
        if value > self.highest:
            self.best, self.highest, self._waited = policy, value, 0
