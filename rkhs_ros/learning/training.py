"""The training loop (Algorithm 1 of the paper), the same over topics and in process."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Protocol

from rkhs_ros.learning.algorithms.algorithm import Experience, Metrics
from rkhs_ros.learning.episodes import Episodes
from rkhs_ros.learning.model.model_based import ModelBased, ModelUpdate, RealExperience, train_in_model
from rkhs_ros.learning.state import State, first_state, first_variance
from rkhs_ros.learning.training_settings import Training
from rkhs_ros.policies.gaussian import GaussianPolicy
from rkhs_ros.policies.spaces import Spaces
from rkhs_ros.policies.streams import Batch
from rkhs_ros.rkhs.kernels import Array

MOST_SAMPLES_AHEAD = 10**5  # of a batch with episodes that run ahead; more rows save nothing, and take memory


class Runner(Protocol):
    """Who lets a policy act: an in-process simulation, or nodes behind topics."""

    @property
    def spaces(self) -> Spaces:
        """Shape of an observation, and bounds of the actions."""

    def capacity(self, num_envs: int) -> int:
        """Return how many of the environments can run side by side."""

    def collect(self, policy: GaussianPolicy, batch: Batch) -> Episodes:
        """Return the episodes of a batch under the policy."""


@dataclass(frozen=True)
class Iteration:
    """One pass of the training loop.

    Attributes:
        state: where the run is after it.
        exploration: this iteration's exploring episodes, before the update.
        exploration_returns: their returns, shape (N,).
        evaluation: evaluation episodes after the update; none, of number 0, in an iteration without evaluation.
        evaluation_returns: their returns.
        metrics: what the update did, the last one of practice.
        model_return: mean return of the last exploring episodes in the model; nan without a model.
        model_error: of the model that came before, at this iteration's episodes; nan where there was none.
        tried: the exploring episodes in which the update tried steps out, as they were collected.
    """

    state: State
    exploration: Episodes
    exploration_returns: Array
    evaluation: Episodes
    evaluation_returns: Array
    metrics: Metrics
    model_return: float = float("nan")
    model_error: float = float("nan")
    tried: tuple[Episodes, ...] = ()

    @property
    def number(self) -> int:
        """Its number, from 1."""
        return self.state.iterations

    @property
    def episodes_used(self) -> int:
        """Number of exploring episodes so far, this iteration's included."""
        return self.state.explored

    @property
    def policy(self) -> GaussianPolicy:
        """The policy after the update."""
        return self.state.policy

    @property
    def exploration_return(self) -> float:
        """Mean return of the exploring episodes."""
        return float(self.exploration_returns.mean())

    @property
    def evaluation_return(self) -> float:
        """Mean return of the evaluation episodes; nan in an iteration without evaluation."""
        return float(self.evaluation_returns.mean()) if len(self.evaluation) else float("nan")


class Collector:
    """Lets policies act in ever new episodes, and counts them.

    After an update the evaluation episodes and the next exploring ones are under the same policy. Where there is room
    for both side by side, the exploring ones run ahead, beside the noise-free ones: the steps are half as many.

    Owns the numbers of the next exploring and the next evaluation episode, and the exploring ones that ran ahead.

    Args:
        training: the learner's settings.
        runner: who lets the policies act.
        state: where the run is.
    """

    def __init__(self, training: Training, runner: Runner, state: State) -> None:
        self._training = training
        self._runner = runner
        self.explored = state.explored
        self.evaluated = state.evaluated
        self._tried: list[Episodes] = []
        self._ahead: Episodes | None = None

    def explore(self, policy: GaussianPolicy) -> Episodes:
        """Return the exploring episodes of an iteration; nobody acted since the policy was evaluated, if it was."""
        ahead, self._ahead = self._ahead, None
        batch = self._exploring(self._training.episodes_per_iteration)
        self.explored += batch.num_envs
        return self._runner.collect(policy, batch) if ahead is None else ahead

    def try_out(self, policy: GaussianPolicy, episodes: int) -> Episodes:
        """Return a number of exploring episodes in which a step is tried out, the policy's inputs as observations."""
        batch = self._exploring(episodes)
        self.explored += episodes
        self._tried.append(self._runner.collect(policy, batch))
        return self._tried[-1].seen_through(policy.inputs)

    def take_tried(self) -> tuple[Episodes, ...]:
        """Return the episodes in which steps were tried out since this was asked last."""
        tried, self._tried = tuple(self._tried), []
        return tried

    def evaluate(self, policy: GaussianPolicy, *, explores_next: bool) -> Episodes:
        """Return evaluation episodes.

        Args:
            policy: who acts.
            explores_next: whether the policy explores in the next iteration.
        """
        training = self._training
        batch = Batch(training.seed, self.evaluated, training.evaluation_episodes, training.horizon, explore=False)
        self.evaluated += batch.num_envs
        if not (explores_next and self._has_capacity_for_both()):
            return self._runner.collect(policy, batch)
        ahead = self._exploring(training.episodes_per_iteration)
        both = self._runner.collect(policy, ahead.with_evaluation(batch))
        self._ahead = both.take(slice(ahead.num_envs))
        return both.take(slice(ahead.num_envs, None))

    def _exploring(self, episodes: int) -> Batch:
        return Batch(self._training.seed, self.explored, episodes, self._training.horizon, explore=True)

    def _has_capacity_for_both(self) -> bool:
        rows = self._training.num_envs
        return rows * self._training.horizon <= MOST_SAMPLES_AHEAD and self._runner.capacity(rows) >= rows


def train(training: Training, runner: Runner, state: State | None = None) -> Iterator[Iteration]:
    """Learn, yielding each iteration as it is done.

    Args:
        training: the learner's settings.
        runner: who lets the policies act.
        state: where to go on from; None to begin.

    Raises:
        ValueError: the settings do not fit the task.
    """
    state = state or first_state(training, runner.spaces)
    collector = Collector(training, runner, state)
    while state.iterations < training.iterations:
        iteration = _iteration_after(state, training, collector, runner.spaces)
        yield iteration
        state = iteration.state


def _iteration_after(state: State, training: Training, collector: Collector, spaces: Spaces) -> Iteration:
    exploration = collector.explore(state.policy)
    policy = state.policy
    if isinstance(training.model, ModelBased):
        memory = state.memory + exploration
        model_update = _train_in_model(training.model, training, policy, memory, spaces, state.iterations)
        policy, metrics = model_update.policy, model_update.metrics
        model_return, model_error = model_update.model_return, model_update.model_error
    else:
        episodes = exploration.seen_through(policy.inputs)
        if state.iterations == 0 and len(policy.mean.centres) == 0:  # a policy given has its kernel
            kernel = training.kernel.fit(episodes.flat(episodes.observations), policy.inputs.ages)
            policy = policy.with_mean(replace(policy.mean, kernel=kernel))
        variance = first_variance(training, spaces)
        experience = Experience(
            episodes, training.discount, state.memory, collector.try_out, variance, state.iterations
        )
        policy, metrics, memory = training.algorithm.update(policy, experience)
        model_return = model_error = float("nan")
    done = state.iterations + 1
    due = training.evaluate_every > 0 and done % training.evaluate_every == 0
    explores_next = done < training.iterations
    evaluation = collector.evaluate(policy, explores_next=explores_next) if due else exploration.take(slice(0))
    return Iteration(
        state=State(done, policy, memory, collector.explored, collector.evaluated),
        exploration=exploration,
        exploration_returns=exploration.returns(training.discount),
        evaluation=evaluation,
        evaluation_returns=evaluation.returns(training.discount),
        metrics=metrics,
        model_return=model_return,
        model_error=model_error,
        tried=collector.take_tried(),
    )


def _train_in_model(
    settings: ModelBased,
    training: Training,
    policy: GaussianPolicy,
    episodes: Episodes,
    spaces: Spaces,
    iteration: int,
) -> ModelUpdate:
    """Return what becomes of the policy with a model learnt from all real episodes so far."""
    experience = RealExperience(
        episodes=episodes,
        newest=training.episodes_per_iteration,
        discount=training.discount,
        spaces=spaces,
        kernel=training.kernel,
        first_variance=first_variance(training, spaces),
        seed=training.seed,
        iteration=iteration,
        outperformed_iterations=outperformed_iterations(
            episodes.returns(training.discount), training.episodes_per_iteration
        ),
    )
    return train_in_model(settings, training.algorithm, policy, experience)


def outperformed_iterations(returns: Array, newest: int) -> float:
    """Return how many earlier iterations, of so many episodes each, earned less than the newest one in the mean."""
    earlier, now = returns[:-newest], returns[-newest:].mean()
    return float((earlier < now).sum() / newest)
