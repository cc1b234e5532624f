"""Batches of environments: copies of an environment that are stepped one by one, or one vector environment."""

import sys
from collections.abc import Callable
from typing import Any

import numpy as np
from gymnasium import Env
from gymnasium.spaces import Dict, Tuple
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.wrappers import FlattenObservation
from gymnasium.wrappers.vector import FlattenObservation as FlattenObservations
from numpy.typing import NDArray

from rkhs_ros.base.endings import RunError
from rkhs_ros.base.user_code import is_interrupt
from rkhs_ros.base.validation import REAL_KINDS, truncated
from rkhs_ros.rkhs.kernels import Array

Flags = NDArray[np.bool_]
AnyEnv = Env[Any, Any]
AnyVectorEnv = VectorEnv[Any, Any, Any]
MOST_COPIES = 32  # of an environment in a batch; more copies do not save time
FLAG_KINDS = "biu"  # numpy kinds of terminated and truncated
MOST_SEEDS = 2**32  # of environments with an old random generator
MOST_VECTORS = 8  # cached vector environments; more than a run has kinds of batches


# Observations after a step, shape (num_envs, d), and per environment its reward, and whether the task ended the episode
# (terminated) or it was cut off (truncated).
Step = tuple[Array, Array, Flags, Flags]


class SeparateEnvs:
    """Copies of an ordinary environment; only active ones are stepped.

    Owns the copies, which are created when needed. If no further copy can be created, for example of hardware, the
    batches become smaller. ``current`` is the index of the environment that is being reset or stepped.

    Args:
        make: function that creates a copy.
        most: maximum number of copies; 0 for ``num_envs`` of the environment's metadata, or `MOST_COPIES`.
    """

    def __init__(self, make: Callable[[], AnyEnv], name: str, most: int = 0) -> None:
        self._make = make
        self._name = name
        self._copies = [_flat(make())]
        self._observations: Array = np.empty((0, 0))
        self.current: int | None = None
        self._most = most or int((self.shown.metadata or {}).get("num_envs", 0)) or MOST_COPIES
        self.observation_space = self._copies[0].observation_space
        self.action_space = self._copies[0].action_space

    @property
    def shown(self) -> AnyEnv:
        """The first environment."""
        return self._copies[0]

    def capacity(self, num_envs: int) -> int:
        """Return how many of the environments can run in one batch, and create the copies."""
        while len(self._copies) < min(num_envs, self._most):
            try:
                self._copies.append(self._another())
            except BaseException as error:  # user code may raise anything
                if is_interrupt(error):
                    raise
                self._most = len(self._copies)
                print(
                    f"warning: {self._name}: limited to {self._most} at a time, since no further copy can be created "
                    f"({type(error).__name__}: {truncated(error)}). Set environment.num_envs={self._most} to hide this",
                    file=sys.stderr,
                )
        return min(num_envs, self._most)

    def _another(self) -> AnyEnv:
        copy = _flat(self._make())
        if any(copy.unwrapped is made.unwrapped for made in self._copies):
            raise ValueError("expected a new environment from each call, got the same one again")
        return copy

    def reset(self, seeds: list[int], horizon: int) -> Array:
        """Reset one environment per seed; return the observations, shape (num_envs, d)."""
        first: list[Array] = []
        for self.current, seed in enumerate(seeds):
            first.append(self._real(reset_to(self._copies[self.current], seed)))
        self._observations = np.stack(first)
        return self._observations.copy()

    def step(self, actions: NDArray[Any], active: Flags) -> Step:
        """Step the active environments with actions of shape ``(num_envs, *shape)``."""
        count = len(self._observations)
        rewards, terminated, truncated = np.zeros(count), np.zeros(count, dtype=bool), np.zeros(count, dtype=bool)
        for i in np.flatnonzero(active).tolist():
            self.current = i
            # The ellipsis keeps an action of shape () an array, like in its space.
            observation, reward, is_end, is_cut, _ = self._copies[i].step(actions[i, ...])
            self._observations[i] = self._real(observation)
            rewards[i] = _each(reward, 1, REAL_KINDS, "reward").item()
            terminated[i] = _each(is_end, 1, FLAG_KINDS, "terminated").item()
            truncated[i] = _each(is_cut, 1, FLAG_KINDS, "truncated").item()
        return self._observations.copy(), rewards, terminated, truncated

    def close(self) -> None:
        """Close the copies."""
        for copy in self._copies:
            copy.close()

    def _real(self, observation: Any) -> Array:
        array = _real(observation, self.observation_space.dtype, self.observation_space.shape or ())
        return array.astype(np.float64).ravel()


class VectorEnvBatch:
    """Environments of a vector environment.

    Owns the vector environments: one for each size of a batch, or a given one for all sizes.

    Args:
        make: function of the number of environments and the horizon that creates a vector environment, or a vector
            environment for all batches.
        most: maximum number of environments; 0 for any number.
    """

    def __init__(self, make: Callable[[int, int], AnyVectorEnv] | AnyVectorEnv, most: int = 0) -> None:
        self._make = make
        self._most = min(make.num_envs, most or make.num_envs) if isinstance(make, VectorEnv) else most
        self._vectors: dict[tuple[int, int], AnyVectorEnv] = {}
        self._current = self._vector(1, 1)
        self.current: int | None = None
        self.observation_space = self._current.single_observation_space
        self.action_space = self._current.single_action_space

    @property
    def shown(self) -> AnyVectorEnv:
        """The vector environment of the last batch."""
        return self._current

    def capacity(self, num_envs: int) -> int:
        """Return how many of the environments can run in one batch."""
        return min(num_envs, self._most or num_envs)

    def reset(self, seeds: list[int], horizon: int) -> Array:
        """Reset one environment per seed; return the observations, shape (num_envs, d)."""
        self._current = self._vector(len(seeds), horizon)
        self._count = len(seeds)
        spare = self._current.num_envs - self._count  # if the size of the vector environment is fixed
        observations, _ = self._current.reset(seed=seeds + seeds[-1:] * spare)  # type: ignore[arg-type]
        return self._flat(observations)

    @property
    def _mode(self) -> Any:
        return self._current.metadata.get("autoreset_mode", AutoresetMode.NEXT_STEP)

    def step(self, actions: NDArray[Any], active: Flags) -> Step:
        """Step all environments with actions of shape ``(num_envs, *shape)``."""
        spare = self._current.num_envs - self._count
        if spare:
            actions = np.concatenate([actions, np.repeat(actions[-1:], spare, axis=0)])
        observations, rewards, terminated, truncated, info = self._current.step(actions)
        # Copies, since the vector environment may use its arrays again.
        rewards = _each(rewards, len(actions), REAL_KINDS, "reward")
        terminated = _each(terminated, len(actions), FLAG_KINDS, "terminated").astype(bool)
        truncated = _each(truncated, len(actions), FLAG_KINDS, "truncated").astype(bool)
        if self._mode != AutoresetMode.NEXT_STEP:
            observations = self._with_final(observations, terminated | truncated, info)
        used = slice(self._count)
        return self._flat(observations), rewards[used], terminated[used], truncated[used]

    def _with_final(self, observations: Any, ended: Flags, info: dict[str, Any]) -> Any:
        """Return the observations, with the final observation of each ended episode in every autoreset mode."""
        if not ended.any():
            return observations
        if self._mode == AutoresetMode.SAME_STEP:
            observations = np.array(observations)
            observations[ended] = np.stack(list(info["final_obs"][ended]))
            return observations
        final = np.array(observations)
        self._current.reset(options={"reset_mask": ended})
        return final

    def _flat(self, observations: Any) -> Array:
        array = _real(observations, np.float64, (len(observations), *(self.observation_space.shape or ())))
        return array.reshape(len(array), -1)[: self._count].copy()

    def close(self) -> None:
        """Close the vector environments."""
        for vector in self._vectors.values():
            vector.close()

    def _vector(self, num_envs: int, horizon: int) -> AnyVectorEnv:
        key = (0, 0) if isinstance(self._make, VectorEnv) else (num_envs, horizon)
        if key not in self._vectors:
            if len(self._vectors) >= MOST_VECTORS:
                oldest = next(iter(self._vectors))
                self._vectors.pop(oldest).close()
            made = self._make if isinstance(self._make, VectorEnv) else self._make(num_envs, horizon)
            nested = isinstance(made.single_observation_space, Dict | Tuple)
            self._vectors[key] = FlattenObservations(made) if nested else made
        return self._vectors[key]


EnvBatch = SeparateEnvs | VectorEnvBatch


def reset_to(env: AnyEnv, seed: int) -> Any:
    """Reset an environment to the start that a seed determines; return its observation.

    An environment that rejects the seed gets its last 32 bits, because the seeds of `numpy.random.RandomState`, which
    for example dm_control uses, have no more.
    """
    try:
        return env.reset(seed=seed)[0]
    except ValueError:
        if seed < MOST_SEEDS:
            raise
        return env.reset(seed=seed % MOST_SEEDS)[0]


def _real(observation: Any, kind: Any, shape: tuple[int, ...]) -> NDArray[Any]:
    """Return an observation as real numbers of a type; numbers too large for the type become infinite."""
    array = np.asarray(observation)
    if array.shape != shape:
        raise RunError(f"expected an observation of shape {shape}, got one of {array.shape}")
    if array.dtype.kind not in REAL_KINDS:
        raise RunError(f"expected an observation of real numbers, got {array.dtype}")
    if array.dtype == kind:
        return array
    with np.errstate(over="ignore"):  # the simulation reports infinite numbers with environment and step
        return array.astype(kind)


def _each(values: Any, count: int, kinds: str, name: str) -> NDArray[Any]:
    """Return a copy of the rewards or flags of a step, which some environments return as an array of one."""
    array = np.array(values)
    if array.size != count or array.dtype.kind not in kinds:
        expected = "True or False" if kinds == FLAG_KINDS else "a real number for each environment"
        raise RunError(f"expected {name} to be {expected}, got {truncated(repr(values))}")
    return array.reshape(count)


def _flat(env: AnyEnv) -> AnyEnv:
    return FlattenObservation(env) if isinstance(env.observation_space, Dict | Tuple) else env
