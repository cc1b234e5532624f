"""A Gymnasium environment as batches of episodes: what stands behind the topics, and what runs in process."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import gymnasium
import numpy as np
from gymnasium.spaces import Box
from gymnasium.vector import VectorEnv
from numpy.typing import NDArray

from rkhs_ros.base.validation import hint
from rkhs_ros.policies.streams import Batch
from rkhs_ros.runs.shown import HasRobot, JointStates

Array = NDArray[np.float64]


MOST_VECTORS = 8  # kept; more than a run has kinds of batches


class Frame(NamedTuple):
    """The rows of a batch after some steps.

    Attributes:
        observations: shape (rows, d).
        rewards: of the step just made, shape (rows,); 0 in rows whose episode was over; none before any step.
        active: True in rows whose episode goes on, shape (rows,).
    """

    observations: Array
    rewards: Array
    active: NDArray[np.bool_]


class Simulation:
    """Episodes of one environment, side by side.

    Owns the environment and the step it is at. Does not own any random state: an episode follows from the
    seeds of its batch. Actions are clipped to the action space here and nowhere before.

    Args:
        environment: Gymnasium id.
        options: keyword options of the environment.

    Raises:
        ValueError: the id is unknown, the options do not fit, or a space is not continuous.
    """

    def __init__(self, environment: str, options: Mapping[str, Any] | None = None) -> None:
        self.environment = environment
        self.options = dict(options or {})
        self._vectors: dict[tuple[int, int], VectorEnv[Any, Any, Any]] = {}
        vector = self._vector(1, 1)
        actions = _continuous(vector.single_action_space, f"{environment} actions")
        self.observation_dim = _size(_continuous(vector.single_observation_space, f"{environment} observations"))
        self.action_dim = _size(actions)
        self.action_low = np.ravel(actions.low).astype(np.float64)
        self.action_high = np.ravel(actions.high).astype(np.float64)
        self.step_seconds = _step_seconds(vector)

    def start(self, batch: Batch) -> Frame:
        """Begin the episodes of a batch."""
        self._current = self._vector(batch.rows, batch.horizon)
        observations, _ = self._current.reset(seed=batch.environment_seeds())  # type: ignore[arg-type]
        self._active = np.ones(batch.rows, dtype=bool)
        return Frame(self._flat(observations), np.zeros(0), self._active)

    def step(self, actions: Array) -> Frame:
        """Make a step in all rows with actions of shape (rows, n), not clipped."""
        space = self._current.single_action_space
        clipped = np.minimum(np.maximum(actions, self.action_low), self.action_high)  # faster than np.clip on few
        shaped = clipped.reshape(len(actions), *(space.shape or ())).astype(space.dtype, copy=False)
        observations, rewards, terminated, truncated, _ = self._current.step(shaped)
        rewards = np.where(self._active, rewards, 0.0)
        self._active = self._active & ~(terminated | truncated)
        return Frame(self._flat(observations), rewards, self._active)

    def joint_states(self) -> JointStates | None:
        """Return what the robot of the first row did in the step just made; None for nothing, or no robot."""
        return self.vector.joint_states() if isinstance(self.vector, HasRobot) else None

    def robot_description(self) -> str | None:
        """Return the robot's URDF; None for a task without a robot."""
        task = self._vector(1, 1)
        return task.robot_description() if isinstance(task, HasRobot) else None

    @property
    def vector(self) -> VectorEnv[Any, Any, Any]:
        """The environment of the batch that was begun last, to look at."""
        return self._current

    def _flat(self, observations: Any) -> Array:
        return np.asarray(observations, dtype=np.float64).reshape(len(observations), -1)

    def _vector(self, rows: int, horizon: int) -> VectorEnv[Any, Any, Any]:
        key = (rows, horizon)
        if key not in self._vectors:
            if len(self._vectors) >= MOST_VECTORS:
                oldest = next(iter(self._vectors))
                self._vectors.pop(oldest).close()
            self._vectors[key] = _make(self.environment, self.options, rows, horizon)
        return self._vectors[key]


def _make(environment: str, options: dict[str, Any], rows: int, horizon: int) -> VectorEnv[Any, Any, Any]:
    try:
        spec = gymnasium.spec(environment)
    except gymnasium.error.Error as error:
        raise ValueError(f"unknown environment '{environment}', {hint(environment, gymnasium.registry)}") from error
    own = spec.vector_entry_point is not None
    mode = (
        {"vectorization_mode": "vector_entry_point"}
        if own
        else {"vectorization_mode": "sync", "disable_env_checker": True}
    )
    try:
        return gymnasium.make_vec(environment, rows, max_episode_steps=horizon, **mode, **options)
    except (TypeError, LookupError) as error:
        raise ValueError(f"environment.options: expected what {environment} takes, got {options} ({error})") from error
    except gymnasium.error.DependencyNotInstalled as error:
        raise ValueError(f"{environment}: expected its packages to be installed, got: {error}") from error


def _step_seconds(vector: VectorEnv[Any, Any, Any]) -> float:
    """Return the seconds of the task's own time that a step stands for; 1 where it does not say."""
    return float(getattr(vector, "step_seconds", 1.0 / vector.metadata.get("render_fps", 1.0)))


def _continuous(space: gymnasium.Space[Any], what: str) -> Box:
    if not isinstance(space, Box) or not np.issubdtype(space.dtype, np.floating):
        raise ValueError(f"{what}: expected a continuous space (a Box of numbers), got {space}")
    return space


def _size(space: Box) -> int:
    return int(np.prod(space.shape))
