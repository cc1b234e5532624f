"""A Gymnasium environment as batches of episodes: what stands behind the topics, and what runs in process."""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from math import inf, prod
from typing import Any, NamedTuple, TypeVar

import gymnasium
import numpy as np
from gymnasium.spaces import Box, Dict, Tuple
from gymnasium.vector import VectorEnv
from numpy.typing import NDArray

from rkhs_ros.base.endings import RunError
from rkhs_ros.base.validation import LARGEST, all_within, require, truncated
from rkhs_ros.policies.input_names import reported_names
from rkhs_ros.policies.spaces import Spaces
from rkhs_ros.policies.streams import Batch
from rkhs_ros.rkhs.kernels import Array
from rkhs_ros.rollouts.env_batch import KEPT, AnyEnv, AnyVectorEnv, Flags
from rkhs_ros.rollouts.environments import Source, env_batch_of, name_of, options_of, own_horizon
from rkhs_ros.rollouts.visualization import HasRobot, JointStates

Answer = TypeVar("Answer")
STEP_SECONDS = ("step_seconds", "dt", "tau")  # attributes of environments, the first one counts
CONTINUOUS = "a continuous space (a Box of numbers)"


class Frame(NamedTuple):
    """The rows of a batch after some steps.

    Attributes:
        observations: shape (rows, d); the last one of rows whose episode is over.
        rewards: of the step just made, shape (rows,); 0 in rows whose episode was over; none before any step.
        active: True in rows whose episode goes on, shape (rows,).
        terminated: True in rows whose episode was ended by the task, shape (rows,).
        truncated: True in rows whose episode was cut off, shape (rows,).
    """

    observations: Array
    rewards: Array
    active: Flags
    terminated: Flags
    truncated: Flags

    @property
    def is_over(self) -> bool:
        """Whether the episodes of all rows are over."""
        return not np.count_nonzero(self.active)  # quicker than any() on few rows

    @property
    def is_whole(self) -> bool:
        """Whether the episodes of all rows go on."""
        return bool(np.count_nonzero(self.active) == len(self.active))


class Simulation:
    """Episodes of one environment, side by side.

    Owns the step it is at, and the environment unless the caller passed one. Does not own any random state: an episode
    follows from the seeds of its batch. Actions are clipped to the action space here and nowhere before.

    Args:
        environment: a Gymnasium id (``module:Id-v0``, too), an environment, a vector environment, or a function that
            makes one.
        options: keyword options of the environment of an id.
        num_envs: rows side by side at most; 0 for as many as the environment allows.

    Raises:
        ValueError: the id is unknown, the options do not fit, or a space is not continuous.
    """

    def __init__(self, environment: Source, options: Mapping[str, Any] | None = None, num_envs: int = 0) -> None:
        self.environment = name_of(environment)
        require(options is None or isinstance(options, Mapping), "options", "a mapping", options)
        self.options = dict(options or {}) if isinstance(environment, str) else options_of(environment)
        good = type(num_envs) is int and num_envs >= 0
        require(good, "num_envs", "a whole number, 0 for any number of rows", num_envs)
        self.num_envs = num_envs
        self._registered = isinstance(environment, str)
        self._is_open = not isinstance(environment, gymnasium.Env | VectorEnv)  # and to be closed by us
        self._rows = env_batch_of(environment, options, num_envs)
        self._batch: Batch | None = None
        self._step = 0
        self._lasts: NDArray[np.int64] = np.empty(0, dtype=np.int64)  # step at which each row is cut off
        self._cuts: frozenset[int] = frozenset()  # the same, each step once
        self._frame: Frame
        with ExitStack() as undo:
            undo.callback(self.close)
            self._describe()
            undo.pop_all()

    def _describe(self) -> None:
        """Set what is known of the task.

        Raises:
            ValueError: a space is not continuous.
        """
        actions = _continuous(self._rows.action_space, f"{self.environment} actions")
        _check_for_images(self._rows.observed, f"{self.environment} observations")
        self.observation_space = _continuous(self._rows.observation_space, f"{self.environment} observations")
        sizes = {"observation": self.observation_space, "action": actions}
        names = (
            reported_names(getattr(self.shown, f"{kind}_names", ()), prod(box.shape)) for kind, box in sizes.items()
        )
        self.spaces = Spaces(self.observation_space.shape, *_bounds(actions), *names)
        self.step_seconds = _step_seconds(self.shown)

    def close(self) -> None:
        """Close the environments that were made here; one that the caller passed stays open."""
        if self._is_open:
            self._is_open = False
            try:
                self._rows.close()
            except Exception as error:  # somebody's code; no result depends on it
                print(
                    f"warning: {self.environment}: close: {type(error).__name__}: {truncated(error)}", file=sys.stderr
                )

    @property
    def own_horizon(self) -> int | None:
        """Steps after which the environment cuts its episodes off itself; None where it does not say."""
        return own_horizon(self.environment if self._registered else self._rows.shown)

    @property
    def shown(self) -> AnyEnv | AnyVectorEnv:
        """The environment of the first row, or of all rows, to look at."""
        return self._rows.shown.unwrapped

    def capacity(self, num_envs: int) -> int:
        """Return how many of the environments can run side by side."""
        return self._rows.capacity(num_envs)

    def start(self, batch: Batch, seeds: Sequence[int] = ()) -> Frame:
        """Begin the episodes of a batch.

        Args:
            batch: the episodes.
            seeds: that the environment is reset with, one for each row, in place of those of the batch; `GOES_ON` in a
                row whose random stream goes on, `KEPT` in one whose episode does, of the batch before.

        Raises:
            ValueError: there is no room for so many rows, or the seeds do not fit.
            RunError: the environment failed, or what it showed is not finite.
        """
        capacity = self.capacity(batch.num_envs)
        require(
            batch.num_envs <= capacity, f"{self.environment}: rows", f"at most {capacity} at a time", batch.num_envs
        )
        kept = self._kept(batch, seeds)
        self._batch = None  # until all rows are as they are to be
        observations = self._asked("reset", self._rows.reset, list(seeds) or batch.environment_seeds(), batch.horizon)
        begun = Frame(
            observations=observations,
            rewards=np.zeros(0),
            active=np.ones(batch.num_envs, dtype=bool),
            terminated=np.zeros(batch.num_envs, dtype=bool),
            truncated=np.zeros(batch.num_envs, dtype=bool),
        )
        lasts = np.full(batch.num_envs, batch.horizon)
        if kept.any():
            before, lasts[kept] = self._frame, self._lasts[kept] - self._step
            begun = Frame(
                observations=np.where(kept[:, None], before.observations, observations),
                rewards=begun.rewards,
                active=~kept | before.active,
                terminated=kept & before.terminated,
                truncated=kept & before.truncated,
            )
        self._batch, self._step, self._lasts, self._frame = batch, 0, lasts, begun
        self._cuts = frozenset(lasts.tolist())
        return self._checked(begun)

    def _kept(self, batch: Batch, seeds: Sequence[int]) -> Flags:
        """Return in which rows the episode is to go on.

        Raises:
            ValueError: there is none under way, or not one seed for each row.
        """
        what = "environment_seeds"
        require(len(seeds) in (0, batch.num_envs), what, f"{batch.num_envs}, one for each row", len(seeds))
        require(all(seed >= KEPT for seed in seeds), what, f"whole numbers >= {KEPT}", seeds)
        kept = np.array([seed == KEPT for seed in seeds] or [False] * batch.num_envs)
        if kept.any():
            before = self._batch
            good = before is not None and (before.seed, before.num_envs) == (batch.seed, batch.num_envs)
            require(good, what, "episodes under way to go on with", "none of that seed")
        return kept

    def step(self, actions: Array) -> Frame:
        """Make a step in the rows whose episode goes on, with actions of shape (rows, n), not clipped.

        Raises:
            RunError: the environment failed, or what it showed is not finite.
        """
        before = self._frame
        self._step += 1
        seen = self._asked(f"step {self._step}", self._rows.step, self.spaces.shaped(actions), before.active)
        truncated = seen.truncated
        if self._step in self._cuts:
            truncated = truncated | (self._step == self._lasts)
        going = ~(seen.terminated | truncated)
        frame = Frame(seen.observations, seen.rewards, going, seen.terminated, truncated)
        self._frame = frame if before.is_whole else _where_active(before, frame)
        return self._checked(self._frame)

    @np.errstate()  # what the environment sets of numpy's errors ends with the call
    def _asked(self, doing: str, call: Callable[..., Answer], *arguments: Any) -> Answer:
        """Return what the environment answers; where it, which is somebody's code, fails, name it, row and step."""
        try:
            return call(*arguments)
        except KeyboardInterrupt:
            raise
        except BaseException as error:
            row = "" if self._rows.current is None else f" of row {self._rows.current}"
            kind = "" if isinstance(error, RunError) else f"{type(error).__name__}: "
            raise RunError(f"{self.environment}: {doing}{row}: {kind}{truncated(error)}") from error

    def _checked(self, frame: Frame) -> Frame:
        """Return a frame of which every number can be learnt from."""
        for quantity, values in (("observation", frame.observations), ("reward", frame.rewards)):
            if not all_within(values, LARGEST):
                row, *column = np.argwhere(~(np.abs(values) <= LARGEST))[0].tolist()  # nan compares false
                raise RunError(
                    f"{self.environment}: {quantity} of row {row} {self._moment()}: expected finite numbers of at most "
                    f"{LARGEST:g} in size, got {values[row, *column]}{f' in column {column[0]}' if column else ''}"
                )
        return frame

    def _moment(self) -> str:
        return f"in step {self._step}" if self._step else "after its reset"

    def joint_states(self) -> JointStates | None:
        """Return what the robot of the first row did in the step just made; None for nothing, or no robot."""
        return self.shown.joint_states() if isinstance(self.shown, HasRobot) else None

    def robot_description(self) -> str | None:
        """Return the robot's URDF; None for a task without a robot."""
        return self.shown.robot_description() if isinstance(self.shown, HasRobot) else None


def _where_active(before: Frame, frame: Frame) -> Frame:
    """Return a frame with the rows as they were whose episode was over before."""
    going = before.active
    return Frame(
        observations=np.where(going[:, None], frame.observations, before.observations),
        rewards=np.where(going, frame.rewards, 0.0),
        active=going & frame.active,
        terminated=before.terminated | (going & frame.terminated),
        truncated=before.truncated | (going & frame.truncated),
    )


def _bounds(space: Box) -> tuple[NDArray[Any], NDArray[Any]]:
    return np.asarray(space.low, dtype=space.dtype), np.asarray(space.high, dtype=space.dtype)


def _step_seconds(environment: AnyEnv | AnyVectorEnv) -> float:
    """Return the seconds of the task's own time that a step stands for; 1 where it does not say.

    Gymnasium's own environments call it ``dt`` or ``tau``; their pictures may come at another rate.
    """
    said = [getattr(environment, name, None) for name in STEP_SECONDS]
    rate = (environment.metadata or {}).get("render_fps")
    said += [1 / rate] if isinstance(rate, int | float) and rate else []
    return next((float(seconds) for seconds in said if isinstance(seconds, int | float) and 0 < seconds < inf), 1.0)


def _continuous(space: gymnasium.Space[Any], what: str) -> Box:
    if not isinstance(space, Box) or not np.issubdtype(space.dtype, np.floating):
        raise ValueError(f"{what}: expected {CONTINUOUS}, got {truncated(space)}")
    require(0 not in space.shape, what, "at least one number", f"the shape {space.shape}")
    return space


def _check_for_images(space: gymnasium.Space[Any], what: str) -> None:
    """Raise ValueError if a space, or one within it, is of images."""
    parts = space.items() if isinstance(space, Dict) else enumerate(space) if isinstance(space, Tuple) else ()
    for name, part in parts:
        _check_for_images(part, f"{what}: {name!r}")
    is_image = isinstance(space, Box) and len(space.shape) >= 2 and not np.issubdtype(space.dtype, np.floating)
    require(not is_image, what, CONTINUOUS, "images, which are not supported")
