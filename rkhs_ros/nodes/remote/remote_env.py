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
MASK = "reset_mask"  # the only option of a reset, of vector environments that are not reset automatically


class RemoteEnv(gymnasium.Env[Any, Any]):
    """One row of a simulator, or a robot, as an ordinary environment.

    Args:
        **options: those of `RemoteSimulation`: ``namespace``, ``domain``, ``timeout``, ``horizon``.
    """

    metadata: Info = {"render_modes": []}

    def __init__(self, *, render_mode: None = None, **options: Any) -> None:
        self.render_mode = render_mode
        self._world = RemoteSimulation(1, **options)
        self.observation_space, self.action_space = _spaces(self._world)

    def reset(self, *, seed: int | None = None, options: Info | None = None) -> tuple[Values, Info]:
        """Begin an episode; without a seed the environment's random stream goes on."""
        seeds = _seeds(seed, 1)
        _check_options(options)
        super().reset(seed=seed)
        seen = self._world.reset(seeds)
        return _shaped(seen, self.observation_space), {}

    def step(self, action: ArrayLike) -> tuple[Values, float, bool, bool, Info]:
        """Make one step."""
        seen = self._world.step(np.reshape(action, (1, -1)))
        ends = bool(seen.terminated[0]), bool(seen.truncated[0])
        return _shaped(seen, self.observation_space), float(seen.rewards[0]), *ends, _info(seen)

    def close(self) -> None:
        """End the connection; nothing is left of it."""
        self._world.close()


class RemoteVectorEnv(VectorEnv[Any, Any, Any]):
    """The rows of one simulator as a vector environment, a batch that is stepped by one message each way.

    Args:
        num_envs: number of rows.
        autoreset_mode: when an episode that is over begins anew.
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
        self._world = RemoteSimulation(num_envs, **options)
        self.single_observation_space, self.single_action_space = _spaces(self._world)
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self._over = np.zeros(num_envs, dtype=bool)

    def reset(self, *, seed: int | list[int | None] | None = None, options: Info | None = None) -> tuple[Values, Info]:
        """Begin an episode in every row, or in those of the mask that is given as an option.

        Args:
            seed: a seed for each row, or one number from which row i takes ``seed + i``; None where its random stream
                goes on.
            options: ``reset_mask``, True in the rows to begin anew, shape (num_envs,).
        """
        seeds, mask = _seeds(seed, self.num_envs), _check_options(options, self.num_envs)
        super().reset(seed=seed if isinstance(seed, int) else None)
        seen = self._world.reset([each if anew else CONTINUE_EPISODE for each, anew in zip(seeds, mask, strict=True)])
        self._over = seen.terminated | seen.truncated
        return _shaped(seen, self.observation_space), {}

    def step(self, actions: ArrayLike) -> tuple[Values, Values, Flags, Flags, Info]:
        """Make one step in every row; those whose episode is over begin anew as the mode says."""
        rows = np.reshape(actions, (self.num_envs, -1))
        if self.autoreset_mode == AutoresetMode.NEXT_STEP and self._over.any():
            return self._step_and_begin_anew(rows)
        seen = self._world.step(rows)
        self._over = ended = seen.terminated | seen.truncated
        observations, info = _shaped(seen, self.observation_space), _infos(seen)
        if self.autoreset_mode == AutoresetMode.SAME_STEP and ended.any():
            final = np.full(self.num_envs, None, dtype=object)
            for row in np.flatnonzero(ended).tolist():
                final[row] = observations[row]
            info |= {"final_obs": final, "_final_obs": ended, "final_info": info.copy(), "_final_info": ended}
            observations = _shaped(self._begin_anew(ended), self.observation_space)
        return observations, seen.rewards, seen.terminated, seen.truncated, info

    def close_extras(self, **kwargs: Any) -> None:
        """End the connection; nothing is left of it."""
        self._world.close()

    def _step_and_begin_anew(self, actions: Values) -> tuple[Values, Values, Flags, Flags, Info]:
        """Begin anew where the episode was over, and make a step in the other rows."""
        anew = self._over
        stepped = None if anew.all() else self._world.step(actions)
        begun = self._begin_anew(anew)
        if stepped is None:
            return _shaped(begun, self.observation_space), begun.rewards, begun.terminated, begun.truncated, {}
        self._over = begun.terminated | begun.truncated
        rewards = np.where(anew, 0.0, stepped.rewards)
        return _shaped(begun, self.observation_space), rewards, begun.terminated, begun.truncated, _infos(stepped)

    def _begin_anew(self, rows: Flags) -> RemoteStep:
        seen = self._world.reset([CONTINUE_STREAM if anew else CONTINUE_EPISODE for anew in rows])
        self._over = seen.terminated | seen.truncated
        return seen


def _shaped(seen: RemoteStep, space: gymnasium.Space[Any]) -> Values:
    """Return the observations in the shape and type of their space."""
    return seen.observations.reshape(space.shape or ()).astype(space.dtype)


def _spaces(world: RemoteSimulation) -> tuple[Box, Box]:
    """Return the spaces of observations and actions; what the world says no bounds of has none."""
    task, spaces = world.task, world.spaces
    shape, kind = spaces.observation_shape, np.dtype(task.observation_type or "float64")
    bounds = [np.array(bound, dtype=kind) for bound in (task.observation_low, task.observation_high)]
    if all(bound.size == spaces.observation_dim for bound in bounds):
        low, high = (bound.reshape(shape) for bound in bounds)
    else:
        low, high = np.full(shape, -np.inf, kind), np.full(shape, np.inf, kind)
    return Box(low, high, dtype=kind.type), Box(
        spaces.action_low, spaces.action_high, dtype=spaces.action_low.dtype.type
    )


def _seeds(seed: int | list[int | None] | None, rows: int) -> list[int]:
    """Return what each row is reset with.

    Raises:
        ValueError: a number is negative, or there is not one for each row.
    """
    if isinstance(seed, int | np.integer):
        given: list[int | None] = [int(seed) + row for row in range(rows)]
    else:
        given = [None] * rows if seed is None else list(seed)
    require(len(given) == rows, "seed", f"{rows}, one for each row", len(given))
    require(all(each is None or 0 <= each < 2**63 for each in given), "seed", "numbers in [0, 2^63)", seed)
    return [CONTINUE_STREAM if each is None else int(each) for each in given]


def _check_options(options: Info | None, rows: int = 0) -> Flags:
    """Return in which rows of a vector environment a reset begins an episode.

    Raises:
        ValueError: there are other options than the mask, which the environment behind the node would not be given.
    """
    given = dict(options or {})
    mask = given.pop(MASK, np.ones(rows, dtype=bool)) if rows else np.ones(0, dtype=bool)
    require(not given, "options", f"{MASK} of a vector environment, or none", ", ".join(given))
    good = isinstance(mask, np.ndarray) and mask.dtype == bool and mask.shape == (rows,) and (mask.any() or not rows)
    require(bool(good), MASK, f"an array of {rows} truth values, one of them True", mask)
    return np.asarray(mask)


def _info(seen: RemoteStep) -> Info:
    return {"discard_reason": seen.discard_reason} if seen.discard_reason else {}


def _infos(seen: RemoteStep) -> Info:
    """Return what is to be told beside a step of several rows; only a robot's single one may be discarded."""
    if not seen.discard_reason:
        return {}
    return {"discard_reason": np.array([seen.discard_reason], dtype=object), "_discard_reason": np.array([True])}
