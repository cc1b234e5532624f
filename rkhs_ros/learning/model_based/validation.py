"""Choose the best policy of the training in a model by rollouts that are the same for all candidates."""

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from rkhs_ros.learning.model.model_rollouts import ModelRunner
from rkhs_ros.policies.gaussian import GaussianPolicy
from rkhs_ros.policies.streams import Batch
from rkhs_ros.rkhs.kernels import Array

PATIENCE = 6  # candidates without improvement after which training ends


class Candidate(NamedTuple):
    """A policy and its returns in the rollouts, shape (J,)."""

    policy: GaussianPolicy
    returns: Array

    @property
    def mean(self) -> float:
        """Mean return."""
        return float(self.returns.mean())


Earned = tuple[GaussianPolicy, Array]  # a policy and its real returns, shape (M >= 0,)


def recommended(earned: Sequence[Earned], runner: ModelRunner, batch: Batch, discount: float) -> Candidate:
    """Return the policy with the greatest expected return.

    Policies that explore are the best in a few functions drawn from the model. For use, a policy must be good on
    average over all that the model considers possible, which counts as much as one of its real episodes.
    """
    candidates = [Candidate(policy, _returns(policy, runner, batch, discount)) for policy, _ in earned]
    expected = [np.append(its, each.mean).mean() for each, (_, its) in zip(candidates, earned, strict=True)]
    return candidates[int(np.argmax(expected))]


def _returns(policy: GaussianPolicy, runner: ModelRunner, batch: Batch, discount: float) -> Array:
    mean = replace(policy, noise="white", action_repeat=1)
    return runner.collect(mean, batch).returns(discount)


class Validation:
    """The policies considered so far, by the returns of rollouts of the policy mean.

    All policies are compared on the same rollouts: with the same functions drawn from the model, starts and noise.

    Args:
        count: number of rollouts J of each policy, at least 2.
        runner: runs the rollouts.
        seed: seed of their random streams.
        horizon: length of a rollout in decisions.
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
        rollouts may lose starts that they do not include.
        """
        if self.kept is None or self.trained is None:
            return self.kept or self.trained
        gain = self.trained.returns - self.kept.returns
        return self.trained if gain.mean() > gain.std() / np.sqrt(len(gain) - 1) else self.kept

    def consider_earlier(self, policy: GaussianPolicy) -> None:
        """Measure a policy of an earlier iteration; one with a constant mean, which is not trained, is ignored."""
        self.kept = self._better(self.kept, policy)

    def consider(self, policy: GaussianPolicy) -> None:
        """Measure a policy of this iteration; one with a constant mean is ignored."""
        before = self.trained
        self.trained = self._better(before, policy)
        self._waited = 0 if self.trained is not before else self._waited + 1

    def resume(self) -> None:
        """Forget how long nothing improved, because training starts again."""
        self._waited = 0

    def _better(self, best: Candidate | None, policy: GaussianPolicy) -> Candidate | None:
        if not policy.mean.weights.any():
            return best
        candidate = Candidate(policy, _returns(policy, self._runner, self._batch, self._discount))
        return candidate if best is None or candidate.mean > best.mean else best
