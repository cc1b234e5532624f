"""Simulation of batches of episodes in a Gymnasium environment, for the simulator node and the in-process runner."""

import sys
from collections.abc import Callable, Mapping, Sequence
from math import inf, prod
from typing import Any, NamedTuple, TypeVar

import gymnasium
import numpy as np
from gymnasium.spaces import Box
from gymnasium.vector import VectorEnv
from numpy.typing import NDArray

from rkhs_ros.base.endings import RunError
from rkhs_ros.base.user_code import is_interrupt
from rkhs_ros.base.validation import LARGEST, all_within, require, truncated
from rkhs_ros.policies.inputs import reported_names
from rkhs_ros.policies.messages import FLOATS
from rkhs_ros.policies.spaces import Spaces
from rkhs_ros.policies.streams import Batch
from rkhs_ros.rkhs.kernels import Array
from rkhs_ros.rollouts.env_batch import AnyEnv, AnyVectorEnv, Flags
from rkhs_ros.rollouts.environments import Source, env_batch_of, name_of, options_of, time_limit

Answer = TypeVar("Answer")
STEP_SECONDS = ("step_seconds", "dt", "tau")  # attributes of environments, by priority
CONTINUOUS = "a continuous space (a Box of floating-point numbers)"


class Frame(NamedTuple):
    """State of a batch of environments after a number of steps.

    Attributes:
        observations: last observation of each episode, shape (num_envs, d).
        rewards: rewards of the last step, 0 after the end of an episode, shape (num_envs,); empty before any step.
        active: True while the episode is not over, shape (num_envs,).
        terminated: True if the task ended the episode, shape (num_envs,).
        truncated: True if the episode was cut off, shape (num_envs,).
    """

    observations: Array
    rewards: Array
    active: Flags
    terminated: Flags
    truncated: Flags

    @property
    def is_over(self) -> bool:
        """Whether all episodes are over."""
        return not np.count_nonzero(self.active)  # faster than any() for few environments

    @property
    def is_whole(self) -> bool:
        """Whether no episode is over."""
        return bool(np.count_nonzero(self.active) == len(self.active))


class Simulation:
    """Batches of episodes in one environment.

    Owns the current step, and the environment unless the caller passed one. Has no random state: the seeds of a batch
    determine its episodes. Clips actions to the action space; no earlier code does.

    Args:
        environment: a Gymnasium id (``module:Id-v0`` imports the module), an environment, a vector environment, or a
            function that returns one.
        options: keyword arguments of the environment; only with an id.
        num_envs: maximum number of environments in a batch; 0 for as many as the environment allows.

    Raises:
        ValueError: the id is unknown, the options do not fit, or a space is not continuous.
    """

    def __init__(self, environment: Source, options: Mapping[str, Any] | None = None, num_envs: int = 0) -> None:
        self.environment = name_of(environment)
        require(options is None or isinstance(options, Mapping), "options", "a mapping", options)
        self.options = dict(options or {}) if isinstance(environment, str) else options_of(environment)
        good = type(num_envs) is int and num_envs >= 0
        require(good, "num_envs", "a whole number, 0 for any number", num_envs)
        self.num_envs = num_envs
        self._registered = isinstance(environment, str)
        self._is_open = not isinstance(environment, gymnasium.Env | VectorEnv)  # and must be closed here
        self._envs = env_batch_of(environment, options, num_envs)
        self._step = self._horizon = 0
        self._frame: Frame
        try:
            self._describe()
        except BaseException:
            self.close()
            raise

    def _describe(self) -> None:
        actions = _continuous(self._envs.action_space, f"{self.environment} actions")
        name = np.dtype(actions.dtype).name
        require(name in FLOATS, f"{self.environment} actions", f"numbers of type {' or '.join(FLOATS)}", name)
        self.observation_space = _continuous(self._envs.observation_space, f"{self.environment} observations")
        sizes = {"observation": self.observation_space, "action": actions}
        names = (
            reported_names(getattr(self.shown, f"{kind}_names", ()), prod(box.shape)) for kind, box in sizes.items()
        )
        bounds: list[NDArray[Any]] = [np.asarray(bound, dtype=actions.dtype) for bound in (actions.low, actions.high)]
        low, high = bounds
        self.spaces = Spaces(self.observation_space.shape, low, high, *names)
        self.step_seconds = _step_seconds(self.shown)

    def close(self) -> None:
        """Close the environments that the simulation created; one that the caller passed stays open."""
        if self._is_open:
            self._is_open = False
            try:
                self._envs.close()
            except Exception as error:  # from user code; no result depends on it
                print(
                    f"warning: {self.environment}: close: {type(error).__name__}: {truncated(error)}", file=sys.stderr
                )

    @property
    def time_limit(self) -> int | None:
        """Time limit of the environment in steps; None if it has none."""
        if self._registered:
            return time_limit(self.environment, self.options)
        return time_limit(self._envs.shown)

    @property
    def shown(self) -> AnyEnv | AnyVectorEnv:
        """The first environment, or the vector environment, for viewers."""
        return self._envs.shown.unwrapped

    def capacity(self, num_envs: int) -> int:
        """Return how many of the environments can run in one batch."""
        return self._envs.capacity(num_envs)

    def start(self, batch: Batch, seeds: Sequence[int] = ()) -> Frame:
        """Start the episodes of a batch.

        The seeds for the resets, one per environment, replace those of the batch.

        Raises:
            ValueError: the batch exceeds the capacity, or the seeds do not fit.
            RunError: the environment failed, or an observation is not finite.
        """
        capacity = self.capacity(batch.num_envs)
        require(batch.num_envs <= capacity, f"{self.environment}: num_envs", f"at most {capacity}", batch.num_envs)
        what = "environment_seeds"
        require(len(seeds) in (0, batch.num_envs), what, f"{batch.num_envs}, one per environment", len(seeds))
        require(all(seed >= 0 for seed in seeds), what, "whole numbers >= 0", seeds)
        observations = self._called("reset", self._envs.reset, list(seeds) or batch.environment_seeds(), batch.horizon)
        self._step, self._horizon = 0, batch.horizon
        self._frame = Frame(
            observations=observations,
            rewards=np.zeros(0),
            active=np.ones(batch.num_envs, dtype=bool),
            terminated=np.zeros(batch.num_envs, dtype=bool),
            truncated=np.zeros(batch.num_envs, dtype=bool),
        )
        return self._checked(self._frame)

    def step(self, actions: Array) -> Frame:
        """Step the active environments with unclipped actions of shape (num_envs, n).

        Raises:
            RunError: the environment failed, or an observation or reward is not finite.
        """
        before = self._frame
        self._step += 1
        observations, rewards, terminated, truncated = self._called(
            f"step {self._step}", self._envs.step, self.spaces.shaped(actions), before.active
        )
        if self._step == self._horizon:
            truncated = np.ones_like(truncated)
        frame = Frame(observations, rewards, ~(terminated | truncated), terminated, truncated)
        self._frame = frame if before.is_whole else _where_active(before, frame)
        return self._checked(self._frame)

    @np.errstate()  # isolates our np.errstate from user code
    def _called(self, doing: str, call: Callable[..., Answer], *arguments: Any) -> Answer:
        """Call the environment; report errors with the environment's id, index and step."""
        try:
            return call(*arguments)
        except BaseException as error:
            if is_interrupt(error):
                raise
            index = "" if self._envs.current is None else f" of environment {self._envs.current}"
            kind = "" if isinstance(error, RunError) else f"{type(error).__name__}: "
            raise RunError(f"{self.environment}: {doing}{index}: {kind}{truncated(error)}") from error

    def _checked(self, frame: Frame) -> Frame:
        """Return a frame, or raise RunError if a number is not finite or too large."""
        for quantity, values in (("observation", frame.observations), ("reward", frame.rewards)):
            if not all_within(values, LARGEST):
                i, *column = np.argwhere(~(np.abs(values) <= LARGEST))[0].tolist()  # nan compares false
                place = f" in column {column[0]}" if column else ""
                moment = f"in step {self._step}" if self._step else "after its reset"
                raise RunError(
                    f"{self.environment}: {quantity} of environment {i} {moment}: expected finite numbers of "
                    f"at most {LARGEST:g} in size, got {values[i, *column]}{place}"
                )
        return frame


def _where_active(before: Frame, frame: Frame) -> Frame:
    """Return a frame in which episodes that were over before are unchanged."""
    active = before.active
    return Frame(
        observations=np.where(active[:, None], frame.observations, before.observations),
        rewards=np.where(active, frame.rewards, 0.0),
        active=active & frame.active,
        terminated=before.terminated | (active & frame.terminated),
        truncated=before.truncated | (active & frame.truncated),
    )


def _step_seconds(environment: AnyEnv | AnyVectorEnv) -> float:
    """Return the simulated time of a step in seconds; 1 if unknown.

    Gymnasium's environments call this ``dt`` or ``tau``; their render rate may differ.
    """
    known = [getattr(environment, name, None) for name in STEP_SECONDS]
    rate = (environment.metadata or {}).get("render_fps")
    known += [1 / rate] if isinstance(rate, int | float) and rate else []
    return next((float(seconds) for seconds in known if isinstance(seconds, int | float) and 0 < seconds < inf), 1.0)


def _continuous(space: gymnasium.Space[Any], what: str) -> Box:
    if not isinstance(space, Box) or not np.issubdtype(space.dtype, np.floating):
        raise ValueError(f"{what}: expected {CONTINUOUS}, got {truncated(space)}")
    require(0 not in space.shape, what, "at least one number", f"the shape {space.shape}")
    return space
