"""A running simulator or robot node as a Gymnasium environment, ``rkhs/Remote-v0``, and as a vector environment."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import gymnasium
import numpy as np
from gymnasium.error import DependencyNotInstalled
from gymnasium.spaces import Box
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import ArrayLike, NDArray

from rkhs_ros.base.ros import EXPECTED, missing_ros
from rkhs_ros.base.validation import require
from rkhs_ros.rollouts.env_batch import CONTINUE_EPISODE, CONTINUE_STREAM, Flags

try:
    from rkhs_ros.nodes.remote.remote_simulation import RemoteSimulation
except ImportError as error:
    got = missing_ros() or error
    raise DependencyNotInstalled(f"rkhs/Remote-v0: expected {EXPECTED}, got none: {got}") from error

if TYPE_CHECKING:
    from rkhs_ros.nodes.remote.remote_simulation import RemoteStep

Values = NDArray[np.floating[Any]]
Info = dict[str, Any]
MASK = "reset_mask"  # the only reset option, for vector environments without automatic resets


class RemoteEnv(gymnasium.Env[Any, Any]):
    """One environment of a simulator, or a robot, as a Gymnasium environment.

    Args:
        **options: those of `RemoteSimulation`: ``namespace``, ``domain``, ``timeout``, ``horizon``.
    """

    metadata: Info = {"render_modes": []}

    def __init__(self, *, render_mode: None = None, **options: Any) -> None:
        self.render_mode = render_mode
        self._remote = RemoteSimulation(1, **options)
        self.observation_space, self.action_space = _spaces(self._remote)

    def reset(self, *, seed: int | None = None, options: Info | None = None) -> tuple[Values, Info]:
        """Start an episode; without a seed the environment's random stream continues."""
        seeds = _seeds(seed, 1)
        _check_options(options)
        super().reset(seed=seed)
        result = self._remote.reset(seeds)
        return _shaped(result, self.observation_space), {}

    def step(self, action: ArrayLike) -> tuple[Values, float, bool, bool, Info]:
        """Make one step."""
        result = self._remote.step(np.reshape(action, (1, -1)))
        ends = bool(result.terminated[0]), bool(result.truncated[0])
        return _shaped(result, self.observation_space), float(result.rewards[0]), *ends, _info(result)

    def close(self) -> None:
        """Close the connection and release its resources."""
        self._remote.close()


class RemoteVectorEnv(VectorEnv[Any, Any, Any]):
    """The environments of one simulator as a vector environment; a step costs one message each way.

    Args:
        num_envs: number of environments.
        autoreset_mode: when an environment whose episode has ended is reset.
        **options: those of `RemoteSimulation`: ``namespace``, ``domain``, ``timeout``, ``horizon``.
    """

    single_observation_space: Box
    single_action_space: Box

    def __init__(
        self,
        num_envs: int = 1,
        *,
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
        render_mode: None = None,
        **options: Any,
    ) -> None:
        self.num_envs = num_envs
        self.render_mode = render_mode
        self.autoreset_mode = AutoresetMode(autoreset_mode)
        self.metadata = {"render_modes": [], "autoreset_mode": self.autoreset_mode}
        self._remote = RemoteSimulation(num_envs, **options)
        self.single_observation_space, self.single_action_space = _spaces(self._remote)
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self._over = np.zeros(num_envs, dtype=bool)

    def reset(self, *, seed: int | list[int | None] | None = None, options: Info | None = None) -> tuple[Values, Info]:
        """Start an episode in every environment, or in those of the mask in the options.

        Args:
            seed: a seed for each environment, or one number, from which environment i gets ``seed + i``; None to
                continue its random stream.
            options: ``reset_mask``, True for the environments to reset, shape (num_envs,).
        """
        seeds, mask = _seeds(seed, self.num_envs), _check_options(options, self.num_envs)
        super().reset(seed=seed if isinstance(seed, int) else None)
        result = self._remote.reset(
            [each if anew else CONTINUE_EPISODE for each, anew in zip(seeds, mask, strict=True)]
        )
        self._over = result.terminated | result.truncated
        return _shaped(result, self.observation_space), {}

    def step(self, actions: ArrayLike) -> tuple[Values, Values, Flags, Flags, Info]:
        """Make one step in every environment; reset those whose episode has ended, depending on the mode."""
        flat = np.reshape(actions, (self.num_envs, -1))
        if self.autoreset_mode == AutoresetMode.NEXT_STEP and self._over.any():
            return self._step_and_restart(flat)
        result = self._remote.step(flat)
        self._over = ended = result.terminated | result.truncated
        observations, info = _shaped(result, self.observation_space), _infos(result)
        if self.autoreset_mode == AutoresetMode.SAME_STEP and ended.any():
            final = np.full(self.num_envs, None, dtype=object)
            for index in np.flatnonzero(ended).tolist():
                final[index] = observations[index]
            info |= {"final_obs": final, "_final_obs": ended, "final_info": info.copy(), "_final_info": ended}
            observations = _shaped(self._restart_envs(ended), self.observation_space)
        return observations, result.rewards, result.terminated, result.truncated, info

    def close_extras(self, **kwargs: Any) -> None:
        """Close the connection and release its resources."""
        self._remote.close()

    def _step_and_restart(self, actions: Values) -> tuple[Values, Values, Flags, Flags, Info]:
        """Reset the environments whose episode has ended, and make a step in the others."""
        anew = self._over
        stepped = None if anew.all() else self._remote.step(actions)
        begun = self._restart_envs(anew)
        if stepped is None:
            return _shaped(begun, self.observation_space), begun.rewards, begun.terminated, begun.truncated, {}
        self._over = begun.terminated | begun.truncated
        rewards = np.where(anew, 0.0, stepped.rewards)
        return _shaped(begun, self.observation_space), rewards, begun.terminated, begun.truncated, _infos(stepped)

    def _restart_envs(self, ended: Flags) -> RemoteStep:
        result = self._remote.reset([CONTINUE_STREAM if anew else CONTINUE_EPISODE for anew in ended])
        self._over = result.terminated | result.truncated
        return result


def _shaped(result: RemoteStep, space: gymnasium.Space[Any]) -> Values:
    """Return the observations with the shape and type of their space."""
    return result.observations.reshape(space.shape or ()).astype(space.dtype)


def _spaces(remote: RemoteSimulation) -> tuple[Box, Box]:
    """Return the observation and action spaces; missing bounds of observations are infinite."""
    task, spaces = remote.task, remote.spaces
    shape, kind = spaces.observation_shape, np.dtype(task.observation_type or "float64")
    bounds = [np.array(bound, dtype=kind) for bound in (task.observation_low, task.observation_high)]
    if all(bound.size == spaces.observation_dim for bound in bounds):
        low, high = (bound.reshape(shape) for bound in bounds)
    else:
        low, high = np.full(shape, -np.inf, kind), np.full(shape, np.inf, kind)
    return Box(low, high, dtype=kind.type), Box(
        spaces.action_low, spaces.action_high, dtype=spaces.action_low.dtype.type
    )


def _seeds(seed: int | list[int | None] | None, num_envs: int) -> list[int]:
    """Return the seed of each environment, or `CONTINUE_STREAM`.

    Raises:
        ValueError: a seed is negative, or there is not one for each environment.
    """
    if isinstance(seed, int | np.integer):
        given: list[int | None] = [int(seed) + index for index in range(num_envs)]
    else:
        given = [None] * num_envs if seed is None else list(seed)
    require(len(given) == num_envs, "seed", f"{num_envs}, one for each environment", len(given))
    require(all(each is None or 0 <= each < 2**63 for each in given), "seed", "numbers in [0, 2^63)", seed)
    return [CONTINUE_STREAM if each is None else int(each) for each in given]


def _check_options(options: Info | None, num_envs: int = 0) -> Flags:
    """Return which environments of a vector environment a reset restarts; `num_envs` is 0 for a single environment.

    Raises:
        ValueError: there are options other than the mask; the remote environment could not receive them.
    """
    given = dict(options or {})
    mask = given.pop(MASK, np.ones(num_envs, dtype=bool)) if num_envs else np.ones(0, dtype=bool)
    require(not given, "options", f"{MASK} for a vector environment, or none", ", ".join(given))
    good = isinstance(mask, np.ndarray) and mask.dtype == bool and mask.shape == (num_envs,)
    require(good and bool(mask.any() or not num_envs), MASK, f"{num_envs} booleans with at least one True", mask)
    return np.asarray(mask)


def _info(result: RemoteStep) -> Info:
    return {"discard_reason": result.discard_reason} if result.discard_reason else {}


def _infos(result: RemoteStep) -> Info:
    """Return the info of a vector environment's step; only a robot's single environment has a discard reason."""
    if not result.discard_reason:
        return {}
    return {"discard_reason": np.array([result.discard_reason], dtype=object), "_discard_reason": np.array([True])}
