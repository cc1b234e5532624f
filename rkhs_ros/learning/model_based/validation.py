"""Choose the best policy of the training in a model by rollouts that are the same for all candidates."""

from typing import NamedTuple

import numpy as np

from rkhs_ros.learning.model.model_rollouts import ModelRunner
from rkhs_ros.policies.gaussian import GaussianPolicy
from rkhs_ros.policies.streams import Batch
from rkhs_ros.rkhs.kernels import Array

PATIENCE = 6  # candidates without improvement after which training ends
CLEAR_GAIN = 0.05  # over a proven policy, relative to what that earned more than the worst one
NOISE_COST = 0.1  # part of that which a proven policy may earn less in real episodes, which explore, than in the model


class Candidate(NamedTuple):
    """A policy and its returns in the rollouts, shape (J,)."""

    policy: GaussianPolicy
    returns: Array

    @property
    def mean(self) -> float:
        """Mean return."""
        return float(self.returns.mean())


class Validation:
    """The policies considered so far, by the returns of rollouts of the policy mean.

    All policies are compared on the same rollouts: with the same functions drawn from the model, starts and noise.

    Args:
        count: number of rollouts J of each policy, at least 2.
        runner: runs the rollouts.
        seed: seed of their random streams.
        horizon: length of a rollout in steps.
        discount: discount factor of the returns.

    Attributes:
        kept: the policy of earlier iterations with the greatest mean return; None if there is none.
        trained: the policy of this iteration with the greatest mean return; None if there is none.
    """

    def __init__(self, count: int, runner: ModelRunner, seed: int, horizon: int, discount: float) -> None:
        self._runner = runner
        self._discount = discount
        self._batch = Batch(seed, 0, count, horizon, explore=False)
        self._waited = 0
        self._hurdle = -np.inf
        self.kept: Candidate | None = None
        self.trained: Candidate | None = None

    @property
    def improves(self) -> bool:
        """Whether one of the last policies of this iteration was better than those before."""
        return self._waited < PATIENCE

    @property
    def best(self) -> Candidate | None:
        """The policy to use.

        It is the best policy of this iteration if the differences of its returns from those of the best earlier policy
        exceed 0 by more than the standard error of their mean. Without this margin, an improvement by chance on these
        rollouts may lose starts that they do not include. A policy that is new altogether must gain clearly on a
        proven one, since it was trained where the model promises most.
        """
        if self.kept is None or self.trained is None:
            return self.kept or self.trained
        gain = self.trained.returns - self.kept.returns
        is_better = gain.mean() > gain.std() / np.sqrt(len(gain) - 1)
        return self.trained if is_better and self.trained.mean > self._hurdle else self.kept

    def consider_earlier(self, policy: GaussianPolicy) -> None:
        """Measure a trained policy of an earlier iteration."""
        self.kept = self._better(self.kept, policy)

    def consider_proven(self, policy: GaussianPolicy, earned: float, worst: float) -> None:
        """Measure the policy of an earlier iteration that earned the most, as the only one to keep.

        Args:
            policy: the policy.
            earned: its return in real episodes.
            worst: least return of all policies there.
        """
        self.kept = self._better(None, policy)
        value = max(earned, min(self.kept.mean, earned + NOISE_COST * (earned - worst)))
        self._hurdle = value + CLEAR_GAIN * (value - worst)

    def consider(self, policy: GaussianPolicy) -> None:
        """Measure a policy of this iteration; one whose mean is 0 is ignored."""
        before = self.trained
        if policy.mean.weights.any():
            self.trained = self._better(before, policy)
        self._waited = 0 if self.trained is not before else self._waited + 1

    def resume(self, runner: ModelRunner) -> None:
        """Forget how long nothing improved, because training goes on from the kept policy with this runner."""
        self._waited = 0
        if self.kept is not None and runner is not self._runner:
            self._runner, self._hurdle, self.trained = runner, -np.inf, None
            self.kept = self._better(None, self.kept.policy)

    def _better(self, best: Candidate | None, policy: GaussianPolicy) -> Candidate:
        candidate = Candidate(policy, self._runner.collect(policy, self._batch).returns(self._discount))
        return candidate if best is None or candidate.mean > best.mean else best
