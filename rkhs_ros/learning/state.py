"""Where a run is between two iterations, and where it begins."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rkhs_ros.base.validation import numbers, require
from rkhs_ros.learning.episodes import Episodes
from rkhs_ros.learning.model.model_based import ModelBased
from rkhs_ros.learning.training_settings import Training
from rkhs_ros.policies.gaussian import GaussianPolicy
from rkhs_ros.policies.spaces import Spaces
from rkhs_ros.policies.variance import ConstantVariance
from rkhs_ros.rkhs.function import Function
from rkhs_ros.rkhs.kernels import RBF, Array


@dataclass(frozen=True)
class State:
    """Where a run is between two iterations: all that the next one follows from, beside the settings.

    Every random stream is a function of seed, name and episode. So the numbers of the next episodes are the whole
    state of the randomness, and a run that goes on from here has the same bits as one that never stopped.

    Attributes:
        iterations: number of iterations done.
        policy: the policy after them.
        memory: episodes that the algorithm asked to keep, or all of them for model-based training; none at first.
        explored: number of exploring episodes so far, which is the number of the next one.
        evaluated: number of evaluation episodes so far.
    """

    iterations: int
    policy: GaussianPolicy
    memory: Episodes
    explored: int
    evaluated: int


def first_policy(training: Training, spaces: Spaces) -> GaussianPolicy:
    """Return the policy with mean 0 that explores first; its kernel is settled by what it sees.

    Raises:
        ValueError: the standard deviations are not one, or one per action dimension; or inputs or kernel do not fit.
    """
    action_dim = spaces.action_dim
    variance = first_variance(training, spaces)
    input_dim = training.inputs.dimension(spaces.observation_dim, action_dim)
    _check_kernel(training, input_dim)
    mean = Function.zero(RBF((1.0,)), input_dim, action_dim)
    policy = GaussianPolicy(mean, ConstantVariance(variance), training.inputs)
    if not isinstance(training.model, ModelBased):
        return policy
    training.model.priors(spaces.observation_dim)
    return training.model.exploration_policy(policy, variance, 0, reward_depends_on_action_only=False)


def first_variance(training: Training, spaces: Spaces) -> Array:
    """Return the variance of the first policy, shape (n,)."""
    sd, action_dim = training.exploration_sd, spaces.action_dim
    if isinstance(sd, str):
        return spaces.half_ranges**2
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
    is_model_based = isinstance(training.model, ModelBased)
    return State(0, policy, memory if is_model_based else memory.seen_through(policy.inputs), 0, 0)


def _fitting_mean(given: GaussianPolicy, first: GaussianPolicy) -> Function:
    require(given.inputs == first.inputs, "inputs", f"{given.inputs}, which the first policy has", first.inputs)
    sizes = [(policy.mean.input_dim, policy.mean.output_dim) for policy in (first, given)]
    expected, got = (f"one from {d} inputs to {n} actions" for d, n in sizes)
    require(expected == got, "first policy", f"{expected}, as the task has", got)
    return given.mean
