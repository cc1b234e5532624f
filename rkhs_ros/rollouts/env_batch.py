"""The rows of a batch: copies of an environment stepped one by one, or the rows of one vector environment."""

from __future__ import annotations

import sys
from collections.abc import Callable
from math import prod
from typing import Any, NamedTuple, Protocol

import numpy as np
from gymnasium import Env, Space
from gymnasium.spaces import Dict, Tuple
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.wrappers import FlattenObservation
from gymnasium.wrappers.vector import FlattenObservation as FlattenObservations
from numpy.typing import NDArray

from rkhs_ros.base.endings import RunError
from rkhs_ros.base.validation import REAL_KINDS, require, truncated
from rkhs_ros.rkhs.kernels import Array

Flags = NDArray[np.bool_]
AnyEnv = Env[Any, Any]
AnyVectorEnv = VectorEnv[Any, Any, Any]
# In place of a seed: the row begins anew, its random stream going on as it is; or its episode goes on.
GOES_ON, KEPT = -1, -2
MOST_COPIES = 32  # of an environment side by side; more of them save nothing
MOST_VECTORS = 8  # vector environments kept; more than a run has kinds of batches


class Step(NamedTuple):
    """What the rows showed after a step.

    Attributes:
        observations: shape (rows, d).
        rewards: shape (rows,).
        terminated: True in rows whose episode ended by the task, shape (rows,).
        truncated: True in rows whose episode was cut off, shape (rows,).
    """

    observations: Array
    rewards: Array
    terminated: Flags
    truncated: Flags


class EnvBatch(Protocol):
    """Rows of one environment that run side by side.

    Attributes:
        observed: observation space of one row, as the environment has it.
        observation_space: of one row, a dictionary or tuple being flattened.
        action_space: of one row.
        shown: the environment of the first row, or of all, to look at.
        current: the row that is being reset or stepped; None where all are at once.
    """

    observed: Space[Any]
    observation_space: Space[Any]
    action_space: Space[Any]
    current: int | None

    @property
    def shown(self) -> AnyEnv | AnyVectorEnv: ...  # noqa: D102

    def capacity(self, num_envs: int) -> int:
        """Return how many of the environments can run side by side."""

    def reset(self, seeds: list[int], horizon: int) -> Array:
        """Begin an episode in as many rows as there are seeds; return the observations, shape (rows, d).

        A seed may be `GOES_ON` or `KEPT`; the observations of rows that are kept mean nothing.
        """

    def step(self, actions: NDArray[Any], active: Flags) -> Step:
        """Make a step with actions of shape ``(rows, *shape)``; what rows show that are not active means nothing."""

    def close(self) -> None:
        """Close the environments."""


class SeparateEnvs:
    """Copies of an ordinary environment; only those are stepped whose episode goes on.

    Owns the copies, which are made when they are first needed. Where another one cannot be made, as of a robot, the
    episodes run one after the other.

    Args:
        make: makes a copy.
        name: of the environment, for messages.
        most: copies at most; 0 for as many as the environment's metadata ``num_envs`` says, or any number.
    """

    def __init__(self, make: Callable[[], AnyEnv], name: str, most: int = 0) -> None:
        self._make = make
        self._name = name
        first = make()
        self.observed = first.observation_space
        self._copies = [_flat(first)]
        self._observations: Array = np.empty((0, 0))
        self.current: int | None = None
        self._most = most or _num_envs(self.shown) or MOST_COPIES
        self.observation_space = self._copies[0].observation_space
        self.action_space = self._copies[0].action_space

    @property
    def shown(self) -> AnyEnv:
        """The environment of the first row."""
        return self._copies[0]

    def capacity(self, num_envs: int) -> int:
        """Return how many of the environments can run side by side, having made the copies."""
        while len(self._copies) < min(num_envs, self._most):
            try:
                self._copies.append(self._another())
            except KeyboardInterrupt:
                raise
            except BaseException as error:
                self._most = len(self._copies)
                print(
                    f"warning: {self._name}: no more than {self._most} at a time, as another copy could not be made "
                    f"({type(error).__name__}: {truncated(error)}); environment.num_envs={self._most} says so",
                    file=sys.stderr,
                )
        return min(num_envs, self._most)

    def _another(self) -> AnyEnv:
        copy = _flat(self._make())
        if any(copy.unwrapped is made.unwrapped for made in self._copies):
            raise ValueError("expected a new environment each time, got the same again")
        return copy

    def reset(self, seeds: list[int], horizon: int) -> Array:
        """Begin an episode in as many rows as there are seeds; return the observations, shape (rows, d)."""
        first: list[Array] = []
        for self.current, seed in enumerate(seeds):
            if seed == KEPT:
                first.append(self._observations[self.current])
            else:
                given = None if seed == GOES_ON else seed
                first.append(self._row(self._copies[self.current].reset(seed=given)[0]))
        self._observations = np.stack(first)
        return self._observations.copy()

    def step(self, actions: NDArray[Any], active: Flags) -> Step:
        """Make a step in the rows that are active, with actions of shape ``(rows, *shape)``."""
        rows = len(self._observations)
        result = Step(self._observations, np.zeros(rows), np.zeros(rows, dtype=bool), np.zeros(rows, dtype=bool))
        for row in np.flatnonzero(active).tolist():
            self.current = row
            # With the dots a single number is an array, too, as its space has it.
            observation, reward, terminated, truncated, _ = self._copies[row].step(actions[row, ...])
            self._observations[row] = self._row(observation)
            result.rewards[row] = np.asarray(reward, dtype=np.float64).item()  # some have it as an array of one
            result.terminated[row], result.truncated[row] = terminated, truncated
        return result._replace(observations=self._observations.copy())

    def close(self) -> None:
        """Close the copies."""
        for copy in self._copies:
            copy.close()

    def _row(self, observation: Any) -> Array:
        row = _real(observation, self.observation_space.dtype)
        _check_size(row.shape, self.observation_space)
        return row.astype(np.float64).ravel()


class VectorEnvBatch:
    """The rows of one vector environment.

    Owns the vector environments, one for each size of a batch, or one for all.

    Args:
        make: makes one of so many rows and steps, or is a vector environment for all batches.
        most: rows at most; 0 for any number.
    """

    def __init__(self, make: Callable[[int, int], AnyVectorEnv] | AnyVectorEnv, most: int = 0) -> None:
        self._make = make
        self._most = make.num_envs if isinstance(make, VectorEnv) else most
        self._vectors: dict[tuple[int, int], AnyVectorEnv] = {}
        self._current = self._vector(1, 1)
        self.current: int | None = None
        self.observation_space = self._current.single_observation_space
        self.action_space = self._current.single_action_space

    @property
    def shown(self) -> AnyVectorEnv:
        """The environment of the batch that was begun last."""
        return self._current

    def capacity(self, num_envs: int) -> int:
        """Return how many of the environments can run side by side."""
        return min(num_envs, self._most or num_envs)

    def reset(self, seeds: list[int], horizon: int) -> Array:
        """Begin an episode in as many rows as there are seeds; return the observations, shape (rows, d)."""
        self._current = self._vector(len(seeds), horizon)
        self._rows = len(seeds)
        spare = self._current.num_envs - self._rows  # of an environment whose size is its own
        seeds = seeds + seeds[-1:] * spare
        if min(seeds) >= 0:
            observations, _ = self._current.reset(seed=seeds)  # type: ignore[arg-type]
        elif set(seeds) == {GOES_ON}:
            observations, _ = self._current.reset()
        else:
            observations, _ = self._current.reset(options={"reset_mask": self._anew(seeds)})
        return self._flat(observations)

    def _anew(self, seeds: list[int]) -> Flags:
        """Return which rows begin anew while others go on.

        Raises:
            RunError: the environment cannot do that.
        """
        if self._mode != AutoresetMode.DISABLED or set(seeds) != {GOES_ON, KEPT}:
            raise RunError("expected all rows to begin anew together, as this environment steps them together")
        return np.array([seed == GOES_ON for seed in seeds])

    @property
    def _mode(self) -> Any:
        return self._current.metadata.get("autoreset_mode", AutoresetMode.NEXT_STEP)

    def step(self, actions: NDArray[Any], active: Flags) -> Step:
        """Make a step in all rows with actions of shape ``(rows, *shape)``."""
        spare = self._current.num_envs - self._rows
        if spare:
            actions = np.concatenate([actions, np.repeat(actions[-1:], spare, axis=0)])
        observations, rewards, terminated, truncated, info = self._current.step(actions)
        if self._mode != AutoresetMode.NEXT_STEP:
            observations = self._as_they_ended(observations, terminated | truncated, info)
        rows = slice(self._rows)
        rewards = np.asarray(rewards).reshape(len(actions))
        return Step(self._flat(observations), rewards[rows], terminated[rows], truncated[rows])

    def _as_they_ended(self, observations: Any, ended: Flags, info: dict[str, Any]) -> Any:
        """Return the observations, those of episodes that ended being their last, whichever way they begin anew."""
        if not ended.any():
            return observations
        if self._mode == AutoresetMode.SAME_STEP:
            observations = np.array(observations)
            observations[ended] = np.stack(list(info["final_obs"][ended]))
            return observations
        kept = np.array(observations)
        self._current.reset(options={"reset_mask": ended})
        return kept

    def _flat(self, observations: Any) -> Array:
        array = _real(observations, np.float64)
        _check_size(array.shape[1:], self.observation_space)
        return array.reshape(len(array), -1)[: self._rows]

    def close(self) -> None:
        """Close the vector environments."""
        for vector in self._vectors.values():
            vector.close()

    def _vector(self, rows: int, horizon: int) -> AnyVectorEnv:
        key = (0, 0) if isinstance(self._make, VectorEnv) else (rows, horizon)
        if key not in self._vectors:
            if len(self._vectors) >= MOST_VECTORS:
                oldest = next(iter(self._vectors))
                self._vectors.pop(oldest).close()
            made = self._make if isinstance(self._make, VectorEnv) else self._make(rows, horizon)
            self.observed = made.single_observation_space
            self._vectors[key] = _flat_vector(made)
        return self._vectors[key]


def _real(observation: Any, kind: Any) -> NDArray[Any]:
    """Return an observation as real numbers of that type, infinite where they are too large for it.

    Raises:
        RunError: they are something else.
    """
    array = np.asarray(observation)
    if array.dtype.kind not in REAL_KINDS:
        raise RunError(f"expected an observation of real numbers, got {array.dtype}")
    if array.dtype == kind:
        return array
    with np.errstate(over="ignore"):  # what is infinite is refused by its row and step
        return array.astype(kind)


def _num_envs(env: AnyEnv) -> int:
    """Return how many copies an environment can have, as its metadata say; 0 for any number."""
    most = (env.metadata or {}).get("num_envs", 0)
    require(type(most) is int and most >= 0, "metadata: num_envs", "a whole number, 0 for any number", repr(most))
    return int(most)


def _check_size(shape: tuple[int, ...], space: Space[Any]) -> None:
    """Raise RunError where an observation has another number of numbers than its space."""
    expected = space.shape or ()
    if shape != expected and prod(shape) != prod(expected):
        raise RunError(f"expected an observation of shape {expected}, got one of {shape}")


def _flat(env: AnyEnv) -> AnyEnv:
    return FlattenObservation(env) if isinstance(env.observation_space, Dict | Tuple) else env


def _flat_vector(env: AnyVectorEnv) -> AnyVectorEnv:
    return FlattenObservations(env) if isinstance(env.single_observation_space, Dict | Tuple) else env
