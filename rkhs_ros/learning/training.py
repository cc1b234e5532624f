"""The training loop (Algorithm 1 of the paper), for in-process simulations and for nodes."""

from collections.abc import Iterator
from dataclasses import replace
from typing import Protocol

from rkhs_ros.base.processes import one_thread
from rkhs_ros.learning.algorithms.algorithm import Experience
from rkhs_ros.learning.discovery import choose_action_repeat, correct_action_repeat, with_features
from rkhs_ros.learning.episodes import Episodes
from rkhs_ros.learning.iteration import Iteration
from rkhs_ros.learning.model_based.real_experience import RealExperience
from rkhs_ros.learning.model_based.training_in_model import Trained, train_in_model
from rkhs_ros.learning.state import (
    Known,
    State,
    chooses_action_repeat,
    first_state,
    first_variance,
    may_correct_action_repeat,
    remembered,
)
from rkhs_ros.learning.training_settings import ModelBased, Training
from rkhs_ros.policies.gaussian import GaussianPolicy
from rkhs_ros.policies.spaces import Spaces
from rkhs_ros.policies.streams import Batch

EARLIER = 5  # policies before the newest one that model-based training may return to


class Runner(Protocol):
    """An object that runs episodes with a policy: an in-process simulation, a model or nodes behind topics."""

    @property
    def spaces(self) -> Spaces:
        """Shape of an observation and bounds of the actions."""

    def collect(self, policy: GaussianPolicy, batch: Batch) -> Episodes:
        """Run the episodes of a batch with the policy."""


class Collector:
    """Collects episodes and counts them.

    Args:
        training: the learner's settings.
        runner: runs the episodes.
        state: state of the run.
    """

    def __init__(self, training: Training, runner: Runner, state: State) -> None:
        self._training = training
        self._runner = runner
        self.explored = state.explored
        self.evaluated = state.evaluated
        self.steps = state.steps
        self._tried: list[Episodes] = []

    def explore(self, policy: GaussianPolicy, episodes: int) -> Episodes:
        """Run exploration episodes."""
        batch = Batch(self._training.seed, self.explored, episodes, self._training.horizon, explore=True)
        explored = self._runner.collect(policy, batch)
        self.explored += episodes
        self.steps += explored.count
        return explored

    def try_out(self, policy: GaussianPolicy, episodes: int) -> Episodes:
        """Run exploration episodes to try a step size; return them with the policy's inputs as observations."""
        tried = self.explore(policy, episodes)
        self._tried.append(tried)
        discount, spaces = self._training.discount, self._runner.spaces
        return tried.decisions(policy.action_repeat, discount, spaces).with_inputs(policy.inputs)

    def take_tried(self) -> tuple[Episodes, ...]:
        """Return the episodes of `try_out` since the last call."""
        tried, self._tried = tuple(self._tried), []
        return tried

    def evaluate(self, policy: GaussianPolicy) -> Episodes:
        """Run evaluation episodes."""
        training = self._training
        batch = Batch(training.seed, self.evaluated, training.evaluation_episodes, training.horizon, explore=False)
        self.evaluated += batch.num_envs
        return self._runner.collect(policy, batch)


def train(training: Training, runner: Runner, state: State | None = None) -> Iterator[Iteration]:
    """Train a policy and yield each iteration when it is complete.

    Args:
        training: the learner's settings.
        runner: runs the episodes.
        state: state to resume from; None for a new run.

    Raises:
        ValueError: the settings do not match the task.
    """
    state = state or first_state(training, runner.spaces)
    collector = Collector(training, runner, state)
    while state.iterations < training.iterations:
        with one_thread():  # not while the caller handles the iteration
            iteration = _iteration_after(state, training, collector, runner.spaces)
        yield iteration
        state = iteration.state


def _iteration_after(state: State, training: Training, collector: Collector, spaces: Spaces) -> Iteration:
    exploration = collector.explore(state.explorer, training.episodes_per_iteration)
    policy = with_action_repeat(state, training, exploration)
    earlier: tuple[GaussianPolicy, ...] = ()
    if isinstance(training.model, ModelBased):
        memory = remembered(state.memory, exploration, training, policy, spaces)
        newest, explorers = training.episodes_per_iteration, (state.explorer, *state.earlier)
        known = newest, policy.action_repeat, state.iterations, explorers, state.policy
        experience = RealExperience(training, spaces, memory, *known)
        trained = train_in_model(training.model, policy, experience)
        earlier = explorers[:EARLIER]
    else:
        repeat = policy.action_repeat
        episodes = exploration.decisions(repeat, training.discount, spaces).with_inputs(policy.inputs)
        if state.iterations == 0 and len(policy.mean.centres) == 0:  # an initial policy brings its kernel
            kernel = training.kernel.fit(episodes.flat(episodes.observations), policy.inputs.ages)
            policy = policy.with_mean(replace(policy.mean, kernel=kernel))
        variance = first_variance(training, spaces)
        update = Experience(
            episodes, training.discount**repeat, state.memory, collector.try_out, variance, state.iterations
        )
        policy, metrics = training.algorithm.update(policy, update)
        trained = Trained(policy, policy, metrics)
        memory = remembered(state.memory, exploration, training, policy, spaces)
    done = state.iterations + 1
    due = training.evaluate_every > 0 and done % training.evaluate_every == 0
    evaluation = collector.evaluate(trained.policy) if due else exploration.take(slice(0))
    counts = collector.explored, collector.evaluated, collector.steps
    return Iteration(
        before=Known.at(state, training),
        state=State(done, trained.policy, trained.explorer, memory, *counts, earlier),
        exploration=exploration,
        exploration_returns=exploration.returns(training.discount),
        evaluation=evaluation,
        evaluation_returns=evaluation.returns(training.discount),
        metrics=trained.metrics,
        model_return=trained.model_return,
        model_error=trained.model_error,
        tried=collector.take_tried(),
    )


def with_action_repeat(state: State, training: Training, exploration: Episodes) -> GaussianPolicy:
    """Return the policy that explored, with its action repeat: chosen or corrected if settings and state ask for it."""
    policy = state.explorer
    if chooses_action_repeat(state, training):
        return replace(policy, action_repeat=choose_action_repeat(with_features(exploration, policy.inputs)))
    if may_correct_action_repeat(state, training):
        episodes = with_features(state.memory + exploration, policy.inputs)
        return replace(policy, action_repeat=correct_action_repeat(policy.action_repeat, episodes))
    return policy
