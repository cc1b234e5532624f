"""The training loop (Algorithm 1 of the paper), the same over topics and in process."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from rkhs_ros.experiments.config import Training
from rkhs_ros.learning.algorithm import Experience, Metrics
from rkhs_ros.learning.episodes import Episodes
from rkhs_ros.policies.gaussian import GaussianPolicy
from rkhs_ros.policies.streams import Batch
from rkhs_ros.policies.variance import ConstantVariance
from rkhs_ros.rkhs.function import Function
from rkhs_ros.rkhs.kernels import RBF
from rkhs_ros.rkhs.validation import require


class Runner(Protocol):
    """Who lets a policy act: an in-process simulation, or nodes behind topics."""

    observation_dim: int
    action_dim: int

    def collect(self, policy: GaussianPolicy, batch: Batch) -> Episodes:
        """Return the episodes of a batch under the policy."""


@dataclass(frozen=True)
class Iteration:
    """One pass of the training loop.

    Attributes:
        number: from 1.
        episodes_used: exploring episodes so far, this iteration's included.
        policy: the policy after the update.
        train_returns: returns of this iteration's exploring episodes, before the update, shape (N,).
        mean_policy_returns: returns of noise-free episodes after the update.
        evaluation: those noise-free episodes, with the policy's inputs as observations.
        metrics: what the update did.
    """

    number: int
    episodes_used: int
    policy: GaussianPolicy
    train_returns: np.ndarray
    mean_policy_returns: np.ndarray
    evaluation: Episodes
    metrics: Metrics


def first_policy(training: Training, observation_dim: int, action_dim: int) -> GaussianPolicy:
    """Return the policy with mean 0 that explores first; its kernel is settled by what it sees.

    Raises:
        ValueError: the standard deviations are not one, or one per action dimension; or the inputs do not fit.
    """
    sd = training.exploration_sd
    require(len(sd) in (1, action_dim), "exploration_sd", f"1 or {action_dim} numbers", len(sd))
    variance = ConstantVariance(np.broadcast_to(np.square(sd), (action_dim,)))
    input_dim = training.inputs.dimension(observation_dim, action_dim)
    return GaussianPolicy(Function.zero(RBF((1.0,)), input_dim, action_dim), variance, training.inputs)


class Collector:
    """Lets policies act in ever new episodes, and counts them.

    Owns the numbers of the next exploring and the next noise-free episode.

    Args:
        training: the learner's settings.
        runner: who lets the policies act.
    """

    def __init__(self, training: Training, runner: Runner) -> None:
        self._training = training
        self._runner = runner
        self._next = {True: 0, False: 0}

    @property
    def episodes_used(self) -> int:
        """Number of exploring episodes so far."""
        return self._next[True]

    def explore(self, policy: GaussianPolicy, episodes: int) -> Episodes:
        """Return a number of exploring episodes, with the policy's inputs as observations."""
        return self._collect(policy, episodes, explore=True)

    def evaluate(self, policy: GaussianPolicy) -> Episodes:
        """Return noise-free episodes, with the policy's inputs as observations."""
        return self._collect(policy, self._training.evaluation_episodes, explore=False)

    def _collect(self, policy: GaussianPolicy, episodes: int, *, explore: bool) -> Episodes:
        batch = Batch(self._training.seed, self._next[explore], episodes, self._training.horizon, explore=explore)
        self._next[explore] += episodes
        return self._runner.collect(policy, batch).seen_through(policy.inputs)


def train(training: Training, runner: Runner) -> Iterator[Iteration]:
    """Learn, yielding each iteration as it is done.

    Args:
        training: the learner's settings.
        runner: who lets the policies act.
    """
    policy = first_policy(training, runner.observation_dim, runner.action_dim)
    collector = Collector(training, runner)
    memory: Episodes | None = None
    for k in range(training.iterations):
        episodes = collector.explore(policy, training.episodes_per_iteration)
        if memory is None:
            kernel = training.kernel.fit(episodes.flat(episodes.observations))
            policy = policy.with_mean(replace(policy.mean, kernel=kernel))
            memory = episodes.take(slice(0))
        experience = Experience(episodes, training.discount, memory, collector.explore, k)
        policy, metrics, memory = training.algorithm.update(policy, experience)
        evaluation = collector.evaluate(policy)
        yield Iteration(
            number=k + 1,
            episodes_used=collector.episodes_used,
            policy=policy,
            train_returns=episodes.returns(training.discount),
            mean_policy_returns=evaluation.returns(training.discount),
            evaluation=evaluation,
            metrics=metrics,
        )
