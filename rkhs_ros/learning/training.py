"""The training loop (Algorithm 1 of the paper), the same over topics and in process."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any, Protocol

import numpy as np

from rkhs_ros.base.settings import Settings, build, setting, variant
from rkhs_ros.base.validation import numbers, require
from rkhs_ros.learning.algorithm import Algorithm, Experience, Metrics
from rkhs_ros.learning.episodes import Episodes
from rkhs_ros.learning.kernel_choice import KernelChoice
from rkhs_ros.learning.practice import (
    PRACTICES,
    ModelPractice,
    NoPractice,
    Practice,
    Practised,
    RealExperience,
    practise,
)
from rkhs_ros.learning.registry import ALGORITHMS
from rkhs_ros.learning.rkhs_nac import RKHSNAC
from rkhs_ros.learning.steps import LineSearch
from rkhs_ros.policies.gaussian import GaussianPolicy
from rkhs_ros.policies.inputs import Inputs
from rkhs_ros.policies.spaces import Spaces
from rkhs_ros.policies.streams import Batch
from rkhs_ros.policies.variance import ConstantVariance
from rkhs_ros.rkhs.function import Function
from rkhs_ros.rkhs.kernels import RBF, Array


@dataclass(frozen=True)
class Training(Settings):
    """The learner's settings."""

    name: str = setting("run", "name of the run and of its folder of results")
    seed: int = setting(0, "seed of all randomness", minimum=0, maximum=2**63 - 1)
    iterations: int = setting(40, "number of policy updates", minimum=1, maximum=10**6)
    episodes_per_iteration: int = setting(10, "exploring episodes before each update", minimum=1, maximum=10_000)
    evaluation_episodes: int = setting(10, "noise-free episodes of an evaluation", minimum=1, maximum=10_000)
    evaluate_every: int = setting(
        1, "iterations from one evaluation by noise-free episodes to the next; 0: none", minimum=0, maximum=10**6
    )
    horizon: int = setting(100, "steps of an episode", minimum=1, maximum=10**6)
    discount: float = setting(0.99, "discount factor of the return, per step", minimum=0.0, maximum=1.0)
    exploration_sd: str | tuple[float, ...] = setting(
        (1.0,),
        "first standard deviation of the actions, one or one per dimension; or 'range': half the range of each action, "
        "1 where it has no bounds",
        minimum=1e-6,
        maximum=1e6,
        choices=("range",),
    )
    simulators: int = setting(
        1, "simulator nodes that share the episodes of a batch; no result depends on it", minimum=1, maximum=64
    )
    timeout: float = setting(20.0, "seconds after which a silent node ends the run", minimum=0.1, maximum=3600.0)
    inputs: Inputs = Inputs()
    kernel: KernelChoice = KernelChoice()
    algorithm: Algorithm = variant(RKHSNAC(), ALGORITHMS, "name")
    practice: Practice = variant(NoPractice(), PRACTICES, "form")

    def __post_init__(self) -> None:
        """Raise ValueError where a value does not fit, or the algorithm wants real episodes that practice has not."""
        super().__post_init__()
        searches = isinstance(getattr(self.algorithm, "step", None), LineSearch)
        good = not (searches and isinstance(self.practice, ModelPractice))
        require(good, "algorithm.step.rule", "fixed or kl for practice.form=model", "line_search")


def training_from(tree: Mapping[str, Any]) -> Training:
    """Return the learner's settings from a tree of values.

    Raises:
        ValueError: an unknown key or a value that does not fit.
    """
    return build(Training, tree)


class Runner(Protocol):
    """Who lets a policy act: an in-process simulation, or nodes behind topics."""

    @property
    def spaces(self) -> Spaces:
        """Shape of an observation, and bounds of the actions."""

    def collect(self, policy: GaussianPolicy, batch: Batch) -> Episodes:
        """Return the episodes of a batch under the policy."""


@dataclass(frozen=True)
class State:
    """Where a run is between two iterations: all that the next one follows from, beside the settings.

    Every random stream is a function of seed, name and episode. So the numbers of the next episodes are the whole
    state of the randomness, and a run that goes on from here has the same bits as one that never stopped.

    Attributes:
        iterations: number of iterations done.
        policy: the policy after them.
        memory: episodes that the algorithm asked to keep, or all of them for practice in a model; none at first.
        explored: number of exploring episodes so far, which is the number of the next one.
        evaluated: number of noise-free episodes so far.
    """

    iterations: int
    policy: GaussianPolicy
    memory: Episodes
    explored: int
    evaluated: int


@dataclass(frozen=True)
class Iteration:
    """One pass of the training loop.

    Attributes:
        state: where the run is after it.
        exploration: this iteration's exploring episodes, before the update.
        train_returns: their returns, shape (N,).
        evaluation: noise-free episodes after the update; none, of number 0, in an iteration without evaluation.
        mean_policy_returns: their returns.
        metrics: what the update did, the last one of practice.
        imagined_return: mean return of the last exploring episodes in the model; nan without practice.
        model_error: of the model that came before, at this iteration's episodes; nan where there was none.
    """

    state: State
    exploration: Episodes
    train_returns: Array
    evaluation: Episodes
    mean_policy_returns: Array
    metrics: Metrics
    imagined_return: float = float("nan")
    model_error: float = float("nan")

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
    def train_return(self) -> float:
        """Mean return of the exploring episodes."""
        return float(self.train_returns.mean())

    @property
    def mean_policy_return(self) -> float:
        """Mean return of the noise-free episodes; nan in an iteration without evaluation."""
        return float(self.mean_policy_returns.mean()) if len(self.evaluation) else float("nan")


def first_policy(training: Training, spaces: Spaces) -> GaussianPolicy:
    """Return the policy with mean 0 that explores first; its kernel is settled by what it sees.

    Raises:
        ValueError: the standard deviations are not one, or one per action dimension; or inputs or kernel do not fit.
    """
    action_dim = spaces.action_dim
    variance = ConstantVariance(_first_variance(training, spaces))
    input_dim = training.inputs.dimension(spaces.observation_dim, action_dim)
    _check_kernel(training, input_dim)
    noise = training.practice.noise if isinstance(training.practice, ModelPractice) else "white"
    return GaussianPolicy(Function.zero(RBF((1.0,)), input_dim, action_dim), variance, training.inputs, noise)


def _first_variance(training: Training, spaces: Spaces) -> Array:
    """Return the variance of the first policy, shape (n,)."""
    sd, action_dim = training.exploration_sd, spaces.action_dim
    if isinstance(sd, str):
        low, high = (bound.ravel().astype(np.float64) for bound in (spaces.action_low, spaces.action_high))
        return np.where(np.isfinite(high - low) & (high > low), 0.5 * (high - low), 1.0) ** 2
    require(len(sd) in (1, action_dim), "exploration_sd", numbers(1, action_dim), len(sd))
    return np.broadcast_to(np.square(sd), (action_dim,))


def _check_kernel(training: Training, input_dim: int) -> None:
    """Raise ValueError where the kernel does not fit the inputs, or the algorithm, whatever will be seen."""
    origin = np.zeros((1, input_dim))
    kernel = training.kernel.fit(origin, training.inputs.ages)
    kernel(origin, origin)
    training.algorithm.check_kernel(kernel)


def first_state(training: Training, spaces: Spaces, warm_start: GaussianPolicy | None = None) -> State:
    """Return the state that a run begins in.

    Args:
        training: the learner's settings.
        spaces: of the task.
        warm_start: a policy whose mean is the first one; it explores as the settings say.

    Raises:
        ValueError: the settings, or the policy, do not fit the task.
    """
    policy = first_policy(training, spaces)
    if warm_start is not None:
        policy = policy.with_mean(_fitting_mean(warm_start, policy))
    memory = Episodes.none(training.horizon, spaces.observation_dim, spaces.action_dim)
    practises = isinstance(training.practice, ModelPractice)
    return State(0, policy, memory if practises else memory.seen_through(policy.inputs), 0, 0)


def _fitting_mean(given: GaussianPolicy, first: GaussianPolicy) -> Function:
    require(given.inputs == first.inputs, "inputs", f"{given.inputs}, which the first policy has", first.inputs)
    sizes = [(policy.mean.input_dim, policy.mean.output_dim) for policy in (first, given)]
    expected, got = (f"one from {d} inputs to {n} actions" for d, n in sizes)
    require(expected == got, "first policy", f"{expected}, as the task has", got)
    return given.mean


class Collector:
    """Lets policies act in ever new episodes, and counts them.

    Owns the numbers of the next exploring and the next noise-free episode.

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

    def explore(self, policy: GaussianPolicy, episodes: int) -> Episodes:
        """Return a number of exploring episodes."""
        first, self.explored = self.explored, self.explored + episodes
        return self._collect(policy, first, episodes, explore=True)

    def explore_inputs(self, policy: GaussianPolicy, episodes: int) -> Episodes:
        """Return a number of exploring episodes, with the policy's inputs as observations."""
        return self.explore(policy, episodes).seen_through(policy.inputs)

    def evaluate(self, policy: GaussianPolicy) -> Episodes:
        """Return noise-free episodes."""
        episodes = self._training.evaluation_episodes
        first, self.evaluated = self.evaluated, self.evaluated + episodes
        return self._collect(policy, first, episodes, explore=False)

    def _collect(self, policy: GaussianPolicy, first: int, episodes: int, *, explore: bool) -> Episodes:
        batch = Batch(self._training.seed, first, episodes, self._training.horizon, explore=explore)
        return self._runner.collect(policy, batch)


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
    while state.iterations < training.iterations:
        iteration = _iteration_after(state, training, runner)
        yield iteration
        state = iteration.state


def _iteration_after(state: State, training: Training, runner: Runner) -> Iteration:
    collector = Collector(training, runner, state)
    exploration = collector.explore(state.policy, training.episodes_per_iteration)
    policy = state.policy
    if isinstance(training.practice, ModelPractice):
        memory = state.memory + exploration
        practised = _practised(training.practice, training, policy, memory, runner.spaces, state.iterations)
        policy, metrics = practised.policy, practised.metrics
        imagined_return, model_error = practised.imagined_return, practised.model_error
    else:
        episodes = exploration.seen_through(policy.inputs)
        if state.iterations == 0 and len(policy.mean.centres) == 0:  # a policy given has its kernel
            kernel = training.kernel.fit(episodes.flat(episodes.observations), policy.inputs.ages)
            policy = policy.with_mean(replace(policy.mean, kernel=kernel))
        experience = Experience(episodes, training.discount, state.memory, collector.explore_inputs, state.iterations)
        policy, metrics, memory = training.algorithm.update(policy, experience)
        imagined_return = model_error = float("nan")
    every = training.evaluate_every
    due = every > 0 and (state.iterations + 1) % every == 0
    evaluation = collector.evaluate(policy) if due else exploration.take(slice(0))
    return Iteration(
        state=State(state.iterations + 1, policy, memory, collector.explored, collector.evaluated),
        exploration=exploration,
        train_returns=exploration.returns(training.discount),
        evaluation=evaluation,
        mean_policy_returns=evaluation.returns(training.discount),
        metrics=metrics,
        imagined_return=imagined_return,
        model_error=model_error,
    )


def _practised(
    practice: ModelPractice,
    training: Training,
    policy: GaussianPolicy,
    episodes: Episodes,
    spaces: Spaces,
    iteration: int,
) -> Practised:
    """Return what becomes of the policy by practice in a model of all real episodes so far."""
    experience = RealExperience(
        episodes=episodes,
        newest=training.episodes_per_iteration,
        discount=training.discount,
        spaces=spaces,
        kernel=training.kernel,
        first_variance=_first_variance(training, spaces),
        seed=training.seed,
        iteration=iteration,
    )
    return practise(practice, training.algorithm, policy, experience)
