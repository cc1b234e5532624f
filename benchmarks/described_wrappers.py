"""Define the Gymnasium wrappers that write a task down differently: other observations or action bounds."""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
from gymnasium.spaces import Box
from gymnasium.utils import seeding

from described_tasks import AnyEnv, Task
from sim_nodes.envs.vector_task import Array

STREAM = 20_231  # separates the random numbers of a description from those of its task


class Described(gymnasium.Wrapper[Any, Any, Any, Any]):
    """A task with other observations.

    Args:
        env: the task.
        low: lower bounds of the observations.
        high: upper bounds of the observations.
        dtype: type of the observations.
    """

    def __init__(self, env: AnyEnv, low: Array, high: Array, dtype: type[np.floating[Any]] = np.float64) -> None:
        super().__init__(env)
        self._dtype = dtype
        self.observation_space = Box(low.astype(dtype), high.astype(dtype), dtype=dtype)

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Start an episode."""
        observation, info = self.env.reset(seed=seed, options=options)
        self.begin(np.asarray(observation, dtype=np.float64), seed)
        return self._observed(observation), info

    def step(self, action: Any) -> tuple[Any, Any, bool, bool, dict[str, Any]]:
        """Make one step."""
        observation, reward, terminated, truncated, info = self.env.step(action)
        return self._observed(observation), reward, terminated, truncated, info

    def begin(self, first: Array, seed: int | None) -> None:
        """Prepare for an episode.

        Args:
            first: first observation of the task.
            seed: seed of the reset; None to continue the random stream.
        """

    def observed(self, observation: Array) -> Array:
        """Return the described observation."""
        return observation

    def _observed(self, observation: Any) -> Any:
        return self.observed(np.asarray(observation, dtype=np.float64)).astype(self._dtype)


class Affine(Described):
    """Multiply each observation column by a factor, then add an offset."""

    def __init__(self, env: AnyEnv, factor: Array | float, offset: Array | float) -> None:
        low, high = _bounds(env)
        super().__init__(env, low * factor + offset, high * factor + offset)
        self._factor, self._offset = factor, offset

    def observed(self, observation: Array) -> Array:  # noqa: D102
        return observation * self._factor + self._offset


class Angles(Described):
    """Observe angles in another form, in the first columns; the other columns follow in their order.

    Args:
        env: the task.
        task: its columns.
        form: "cosine-sine" (all cosines, then all sines), "wrapped" to [-pi, pi], "unwrapped" (with the turns since
            the start of the episode), or "degrees" (wrapped to [-180, 180], angular velocities in degrees per second).
    """

    def __init__(self, env: AnyEnv, task: Task, form: str) -> None:
        self._task, self._form = task, form
        low, high = _bounds(env)
        self._rest = [column for column in range(len(low)) if column not in task.angles + task.cosines + task.sines]
        self._units = np.ones(len(low))
        if form == "degrees":
            self._units[list(task.angular_velocities)] = 180.0 / np.pi
        count = len(task.angles) or len(task.cosines)
        most = {"cosine-sine": [1.0] * 2 * count, "unwrapped": [np.inf] * count, "degrees": [180.0] * count}
        first = np.array(most.get(form, [np.pi] * count))
        low, high = (bounds * self._units for bounds in (low, high))
        super().__init__(env, np.concatenate([-first, low[self._rest]]), np.concatenate([first, high[self._rest]]))

    def begin(self, first: Array, seed: int | None) -> None:  # noqa: D102
        self._last = self._wrapped(first)

    def observed(self, observation: Array) -> Array:  # noqa: D102
        angles = self._wrapped(observation)
        if self._form == "cosine-sine":
            angles = np.concatenate([np.cos(angles), np.sin(angles)])
        elif self._form == "degrees":
            angles = np.degrees(angles)
        elif self._form == "unwrapped":  # no angle turns by half a turn in a step
            angles = self._last = self._last + (angles - self._last + np.pi) % (2 * np.pi) - np.pi
        return np.concatenate([angles, (observation * self._units)[self._rest]])

    def _wrapped(self, observation: Array) -> Array:
        if self._task.angles:
            return observation[list(self._task.angles)]
        return np.arctan2(observation[list(self._task.sines)], observation[list(self._task.cosines)])


class Columns(Described):
    """Observe some of the columns, in a given order; a column may occur twice."""

    def __init__(self, env: AnyEnv, columns: list[int]) -> None:
        low, high = _bounds(env)
        super().__init__(env, low[columns], high[columns])
        self._columns = columns

    def observed(self, observation: Array) -> Array:  # noqa: D102
        return observation[self._columns]


class ConstantColumn(Described):
    """Append a column that is always 1."""

    def __init__(self, env: AnyEnv) -> None:
        low, high = _bounds(env)
        super().__init__(env, np.append(low, 1.0), np.append(high, 1.0))

    def observed(self, observation: Array) -> Array:  # noqa: D102
        return np.append(observation, 1.0)


class Random(Described):
    """Add independent normal noise, with a stream of its own that the seed of the reset determines.

    Args:
        env: the task.
        sds: standard deviation of the noise in each column.
        columns: number of further columns, which contain standard normal noise only.
    """

    def __init__(self, env: AnyEnv, sds: Array, columns: int) -> None:
        low, high = (
            np.where(sds > 0, sign * np.inf, bounds) for sign, bounds in zip((-1, 1), _bounds(env), strict=True)
        )
        further = np.full(columns, np.inf)
        super().__init__(env, np.concatenate([low, -further]), np.concatenate([high, further]))
        self._sds, self._columns = sds, columns
        self._stream, _ = seeding.np_random()  # until a reset has a seed

    def begin(self, first: Array, seed: int | None) -> None:  # noqa: D102
        if seed is not None:
            self._stream = np.random.default_rng([STREAM, seed])

    def observed(self, observation: Array) -> Array:  # noqa: D102
        noise = self._stream.standard_normal(len(observation) + self._columns)
        return np.concatenate([observation + self._sds * noise[: len(observation)], noise[len(observation) :]])


class Late(Described):
    """Observe everything one step late; the first observation occurs twice."""

    def __init__(self, env: AnyEnv) -> None:
        super().__init__(env, *_bounds(env))

    def begin(self, first: Array, seed: int | None) -> None:  # noqa: D102
        self._last = first

    def observed(self, observation: Array) -> Array:  # noqa: D102
        late, self._last = self._last, observation
        return late


class Single(Described):
    """Observe in single precision."""

    def __init__(self, env: AnyEnv) -> None:
        super().__init__(env, *_bounds(env), dtype=np.float32)


class WideActions(gymnasium.ActionWrapper[Any, Any, Any]):
    """Declare action bounds twice as wide around the same centre; actions beyond the true ones are clipped."""

    def __init__(self, env: AnyEnv) -> None:
        super().__init__(env)
        true: Any = env.action_space
        self._low, self._high = true.low, true.high
        excess = (true.high - true.low) / 2
        self.action_space = Box(true.low - excess, true.high + excess, dtype=true.dtype)

    def action(self, action: Any) -> Any:  # noqa: D102
        return np.clip(action, self._low, self._high)


def _bounds(env: AnyEnv) -> tuple[Array, Array]:
    space: Any = env.observation_space
    return space.low.astype(np.float64), space.high.astype(np.float64)
