"""The state of a run between two iterations, its initial state, and what the data revealed by then."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from rkhs_ros.base.validation import numbers, require
from rkhs_ros.learning.algorithms.function_spaces import Grid
from rkhs_ros.learning.episodes import Episodes
from rkhs_ros.learning.training_settings import AUTO, ModelBased, Training
from rkhs_ros.policies.gaussian import GaussianPolicy
from rkhs_ros.policies.inputs import Inputs
from rkhs_ros.policies.spaces import Spaces
from rkhs_ros.policies.variance import ConstantVariance
from rkhs_ros.rkhs.function import Function
from rkhs_ros.rkhs.kernels import RBF, Array


@dataclass(frozen=True)
class State:
    """The complete state of a run between two iterations; with the settings it determines the next iteration.

    Every random stream is a function of seed, name and episode, so the episode counts are the whole state of the
    random numbers. A run that resumes from a state is bit-identical to one that was never interrupted.

    Attributes:
        iterations: number of completed iterations.
        policy: the policy after them, which is evaluated.
        explorer: the policy of the next exploration episodes; without a model, this is the policy.
        memory: episodes that the next update reuses, or all episodes for model-based training; empty at first.
        explored: number of exploration episodes so far, which is the number of the next one.
        evaluated: number of evaluation episodes so far.
        steps: number of environment steps of the exploration episodes so far.
        earlier: the last policies that explored, the newest first; empty without a model.
    """

    iterations: int
    policy: GaussianPolicy
    explorer: GaussianPolicy
    memory: Episodes
    explored: int
    evaluated: int
    steps: int
    earlier: tuple[GaussianPolicy, ...] = ()


def first_policy(training: Training, spaces: Spaces) -> GaussianPolicy:
    """Return the initial policy, whose mean is the middle of the bounds; the first iteration determines its kernel.

    Raises:
        ValueError: the standard deviations, the inputs or the kernel do not match the task.
    """
    action_dim = spaces.action_dim
    variance = first_variance(training, spaces)
    input_dim = training.inputs.dimension(spaces.observation_dim, action_dim)
    _check_kernel(training, input_dim)
    mean = Function.constant(RBF((1.0,)), input_dim, action_dim, spaces.middle)
    repeat = training.action_repeat if isinstance(training.action_repeat, int) else 1  # until it is chosen
    inputs = training.inputs.within(spaces)
    if isinstance(training.model, ModelBased):
        training.model.priors(spaces.observation_dim)  # so that a wrong name ends the run before its first episode
    return GaussianPolicy(mean, ConstantVariance(variance), inputs, action_repeat=repeat)


def first_variance(training: Training, spaces: Spaces) -> Array:
    """Return the variance of the initial policy, shape (n,)."""
    sd, action_dim = training.exploration_sd, spaces.action_dim
    if isinstance(sd, str):
        return spaces.half_ranges**2
    require(len(sd) in (1, action_dim), "exploration_sd", numbers(1, action_dim), len(sd))
    return np.broadcast_to(np.square(sd), (action_dim,))


def _check_kernel(training: Training, input_dim: int) -> None:
    """Raise ValueError if the kernel does not fit the inputs or the algorithm, whatever the data."""
    origin = np.zeros((1, input_dim))
    kernel = training.kernel.fit(origin, training.inputs.ages)
    kernel(origin, origin)
    training.algorithm.check_kernel(kernel)
    if isinstance(training.algorithm, Grid):
        training.algorithm.grid_centres(input_dim)


def first_state(training: Training, spaces: Spaces, warm_start: GaussianPolicy | None = None) -> State:
    """Return the initial state of a run.

    Args:
        training: the learner's settings.
        spaces: spaces of the task.
        warm_start: initial policy, for example from ``rkhs imitate``; its mean is used, with the settings' exploration
            and action repeat. With ``action_repeat: auto``, its own action repeat is used; if the run finds its inputs
            in the data, the policy's inputs are those found so far.

    Raises:
        ValueError: the settings or the initial policy do not match the task.
    """
    discovers = isinstance(training.model, ModelBased) and training.model.discovery != "none"
    if warm_start is not None and discovers and training.inputs == Inputs():
        training = replace(training, inputs=warm_start.inputs)
    policy = first_policy(training, spaces)
    if warm_start is not None:
        if training.action_repeat == AUTO:
            policy = replace(policy, action_repeat=warm_start.action_repeat)
        policy = policy.with_mean(_checked_mean(warm_start, policy))
        training.algorithm.check_kernel(policy.mean.kernel)
    memory = Episodes.none(training.horizon, spaces.observation_dim, spaces.action_dim)
    is_model_based = isinstance(training.model, ModelBased)
    return State(0, policy, policy, memory if is_model_based else memory.with_inputs(policy.inputs), 0, 0, 0)


def remembered(
    memory: Episodes, exploration: Episodes, training: Training, policy: GaussianPolicy, spaces: Spaces
) -> Episodes:
    """Return the memory of a run after an iteration, whose exploration episodes are as observed.

    Without a model, the inputs and the action repeat of the policy are constant.
    """
    if isinstance(training.model, ModelBased):
        return memory + exploration
    repeat, discount = policy.action_repeat, training.discount
    episodes = exploration.decisions(repeat, discount, spaces).with_inputs(policy.inputs)
    return training.algorithm.remembered(episodes + memory, discount**repeat)


def chooses_action_repeat(state: State, training: Training) -> bool:
    """Return whether the next episodes choose the action repeat: only the first ones, if there is no initial policy."""
    return training.action_repeat == AUTO and state.iterations == 0 and len(state.policy.mean.centres) == 0


def may_correct_action_repeat(state: State, training: Training) -> bool:
    """Return whether the next episodes may correct the chosen action repeat: the second or third ones, and only once.

    With a model, the state contains all episodes and the earlier policies, the initial one included.
    """
    if training.action_repeat != AUTO or state.iterations not in (1, 2) or not state.earlier:
        return False
    *trained, initial = state.explorer, *state.earlier
    return len(initial.mean.centres) == 0 and len({policy.action_repeat for policy in trained}) == 1


def _checked_mean(given: GaussianPolicy, first: GaussianPolicy) -> Function:
    require(
        given.inputs.is_equivalent_to(first.inputs), "inputs", f"{given.inputs} like the initial policy", first.inputs
    )
    if given.inputs.history > 1:  # a history of decisions
        repeat = given.action_repeat
        require(
            repeat == first.action_repeat, "action_repeat", f"{repeat} like the initial policy", first.action_repeat
        )
    sizes = [(policy.mean.input_dim, policy.mean.output_dim) for policy in (first, given)]
    expected, got = (f"one from {d} inputs to {n} actions" for d, n in sizes)
    require(expected == got, "initial policy", f"{expected} like the task", got)
    return given.mean


class Known(NamedTuple):
    """What a run knows about its task: at which rate and from which inputs the policy decides.

    Attributes:
        action_repeat: action repeat of the policy; 0 if it is still to be chosen.
        inputs: inputs of the policy.
    """

    action_repeat: int
    inputs: Inputs

    @classmethod
    def at(cls, state: State, training: Training) -> Known:
        """Return what is known in a state of a run."""
        return cls(0 if chooses_action_repeat(state, training) else state.policy.action_repeat, state.policy.inputs)


def settings_of(before: Known, after: Known) -> list[str]:
    """Return the settings that differ from what was known before, as ``KEY=VALUE``."""
    settings = []
    if after.action_repeat != before.action_repeat:
        settings.append(f"action_repeat={after.action_repeat}")
    if after.inputs.columns != before.inputs.columns:
        columns = ",".join(map(str, after.inputs.columns))
        settings.append(f"inputs.angles=[{columns}]" if columns else "inputs.angles=none")
        if columns and not np.allclose(after.inputs.full_turns, 2 * np.pi):
            settings.append(f"inputs.turns=[{','.join(map(repr, after.inputs.full_turns.tolist()))}]")
    if after.inputs.history != before.inputs.history:
        settings.append(f"inputs.history={after.inputs.history}")
    return settings
