"""Export a policy to ONNX after a check that it acts like the original, and measure the time of a call."""

from dataclasses import replace
from pathlib import Path
from time import perf_counter
from typing import Any, NamedTuple

import numpy as np

from rkhs_ros.base.files import write_whole
from rkhs_ros.base.validation import require
from rkhs_ros.policies.onnx_graph import STATE, missing, onnx_model
from rkhs_ros.policies.policy import Policy
from rkhs_ros.rkhs.kernels import Array, deviations

TOLERANCE = 1e-6  # relative to the greatest action
COUNT, EPISODES = 10_000, 100  # minimum number of observations; episodes per batch
CALLS = 1000  # timed calls
SPREAD = 2.0  # of the observations, in standard deviations of the centres


class OnnxCheck(NamedTuple):
    """Result of a check.

    Attributes:
        observations: number of random observations.
        error: greatest difference between the actions, relative to the greatest action.
        seconds: median duration of a call with one observation on one thread, in seconds.
    """

    observations: int
    error: float
    seconds: float


class OnnxPolicy:
    """An exported policy on one thread of ONNX Runtime, called like `Policy`.

    Args:
        content: content of the ONNX file.

    Raises:
        ValueError: onnxruntime is not installed.
    """

    def __init__(self, content: bytes) -> None:
        try:
            import onnxruntime
        except ImportError as error:
            raise missing("onnxruntime") from error
        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = options.inter_op_num_threads = 1
        self._session = onnxruntime.InferenceSession(content, options, providers=["CPUExecutionProvider"])
        self._columns = {value.name: value.shape[1:] for value in self._session.get_inputs()}.get(STATE)
        self._state: Any = None

    def reset(self) -> None:
        """Start a new episode."""
        self._state = None

    def __call__(self, observations: Array) -> Array:
        """Return the clipped mean actions, shape (batch, *action_shape).

        Args:
            observations: finite float64 numbers, shape (batch, *observation_shape).
        """
        if self._columns is None:
            action: Array = self._session.run(None, {"observation": observations})[0]
            return action
        state = np.zeros((len(observations), *self._columns)) if self._state is None else self._state
        action, self._state = self._session.run(None, {"observation": observations, STATE: state})
        return action


def export_onnx(policy: Policy, file: Path) -> OnnxCheck:
    """Write a policy to an ONNX file if the graph acts like the policy; return the result of the check.

    Raises:
        ValueError: onnx or onnxruntime is not installed, the kernel has no ONNX implementation, or the check fails.
        OSError: the file cannot be written.
    """
    content = onnx_model(policy)
    check = check_onnx(policy, content)
    write_whole(file, content)
    return check


def check_onnx(policy: Policy, content: bytes) -> OnnxCheck:
    """Compare an exported policy with the original in random episodes.

    The episodes are just long enough to fill the window. In longer ones, rounding errors could grow, because the window
    feeds actions back. Steps are ignored if the action of the original is not finite.

    Raises:
        ValueError: onnxruntime is not installed, or the actions differ by more than the tolerance.
    """
    low, high = (bound.astype(np.float64) for bound in (policy.spaces.action_low, policy.spaces.action_high))
    exact = Policy(policy.gaussian, policy.task, replace(policy.spaces, action_low=low, action_high=high))
    exported, observations = OnnxPolicy(content), random_observations(policy)
    with np.errstate(over="ignore", invalid="ignore"):
        expected, got = (np.stack([_acted(each, steps) for steps in observations]) for each in (exact, exported))
        error = np.abs(got - expected)[finite := np.isfinite(expected)].max(initial=0.0)
    greatest = np.abs(expected[finite]).max(initial=0.0)
    relative = float(error / greatest) if greatest else float(error)
    what = f"the actions of the policy within {TOLERANCE:g}"
    require(bool(finite.any()) and relative <= TOLERANCE, "policy.onnx", what, f"a difference of {relative:g}")
    count = len(observations) * observations.shape[1] * EPISODES
    return OnnxCheck(count, relative, _median_seconds(exported, observations[0, :, :1]))


def random_observations(policy: Policy) -> Array:
    """Return at least ``COUNT`` observations around the centres, shape (blocks, steps, EPISODES, ...).

    Angles are uniformly distributed over a full turn. The other columns are normally distributed: with the mean of the
    centres' column and ``SPREAD`` times its standard deviation, or, if the inputs are monomials or there are no
    centres, with mean 0 and standard deviation ``SPREAD``.
    """
    rng, spaces, inputs = np.random.default_rng(0), policy.spaces, policy.gaussian.inputs
    d, centres = spaces.observation_dim, policy.gaussian.mean.centres
    steps = inputs.history * policy.gaussian.action_repeat + 1
    shape = (-(-COUNT // (steps * EPISODES)), steps, EPISODES)
    rest = [column for column in range(d) if column not in inputs.columns]
    observations = SPREAD * rng.normal(size=(*shape, d))
    if len(centres) and rest and not inputs.degree:
        end = centres.shape[1] - (spaces.action_dim if inputs.history > 1 else 0)
        near = centres[:, end - len(rest) : end]  # of the newest observation
        observations[..., rest] = near.mean(axis=0) + observations[..., rest] * deviations(near)
    observations[..., inputs.columns] = rng.uniform(-0.5, 0.5, (*shape, len(inputs.columns))) * inputs.full_turns
    return observations.reshape(*shape, *spaces.observation_shape)


def _acted(acting: Policy | OnnxPolicy, steps: Array) -> Array:
    """Return the actions in a batch of episodes, shape (steps, EPISODES, *action_shape)."""
    acting.reset()
    return np.stack([acting(observations) for observations in steps])


def _median_seconds(exported: OnnxPolicy, steps: Array) -> float:
    exported.reset()
    seconds = []
    for call in range(CALLS):
        begin = perf_counter()
        exported(steps[call % len(steps)])
        seconds.append(perf_counter() - begin)
    return float(np.median(seconds))
