"""A task as the rows of one Gymnasium vector environment, and one such row as an ordinary environment."""

from __future__ import annotations

from abc import abstractmethod
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple

import gymnasium
import numpy as np
from gymnasium.utils import seeding
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

if TYPE_CHECKING:  # a node draws nothing and need not wait for it
    from matplotlib.axes import Axes

Array = NDArray[np.float64]

NOISE_BLOCK = 128  # steps
BLUE, ORANGE, GREEN = "#0072B2", "#D55E00", "#009E73"  # of what is drawn: the colour-blind tell them apart
DARK, PALE = "#26262B", "#CCCCCC"


def clip(values: Array, low: Array | float, high: Array | float) -> Array:
    """Return the values within bounds; several times faster than `numpy.clip` on few values."""
    return np.minimum(np.maximum(values, low), high)


class JointStates(NamedTuple):
    """A motion of a robot's joints.

    Attributes:
        names: of the joints.
        positions: one after another, in radians or metres, shape (k, joints).
        period: seconds from one to the next.
    """

    names: tuple[str, ...]
    positions: Array
    period: float


class Body(NamedTuple):
    """A rigid body that is seen.

    Attributes:
        shape: "box", "ball" or "cylinder", whose axis is z.
        size: along x, y and z, in metres.
        colour: as "#0072B2", red, green and blue.
    """

    shape: str
    size: tuple[float, float, float]
    colour: str


class BodyTrajectories(NamedTuple):
    """How bodies move; z is up.

    Attributes:
        times: of each moment, in seconds, shape (k,).
        positions: of the middles, in metres, shape (k, bodies, 3).
        orientations: unit quaternions w, x, y, z, shape (k, bodies, 4).
    """

    times: Array
    positions: Array
    orientations: Array


def upright(positions: Array) -> Array:
    """Return the orientations of bodies that do not turn, for positions of shape (k, bodies, 3)."""
    return np.broadcast_to([1.0, 0.0, 0.0, 0.0], (*positions.shape[:2], 4))


class VectorTask(VectorEnv[Array, Array, Any]):
    """Rows of one task, stepped together, each with a random stream of its own.

    A subclass gives the spaces, the number of noise draws of a transition, and four formulas over rows.
    Actions are clipped to their space. The rows are always at the same step; after the last one the next step
    starts them anew.

    Args:
        num_envs: number of rows.
        max_episode_steps: steps after which an episode is truncated; None for never.
    """

    metadata: dict[str, Any] = {"autoreset_mode": AutoresetMode.NEXT_STEP, "render_modes": []}
    single_observation_space: Any
    single_action_space: Any
    noise_dim: int  # standard normal draws of a transition
    observation_noise_dim: int = 0  # and of an observation
    step_seconds: float = 1.0  # that a step stands for
    reference_returns: ClassVar[dict[str, float]] = {}  # at the registered horizon and discount 0.99
    observation_names: ClassVar[tuple[str, ...]] = ()  # of each number, with its unit, for pictures
    action_names: ClassVar[tuple[str, ...]] = ()

    def __init__(self, num_envs: int = 1, max_episode_steps: int | None = None) -> None:
        self.num_envs = num_envs
        self.max_episode_steps = max_episode_steps
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        # One for each row: arrays of the same shape are quicker to compare than those that are broadcast.
        actions: Any = self.action_space
        self._action_bounds: tuple[Array, Array] = actions.low, actions.high
        self._streams: list[np.random.Generator] = []

    @abstractmethod
    def initial_states(self, rows: int) -> Array:
        """Return the states at the start of an episode, shape (rows, state_dim)."""

    @abstractmethod
    def transition(self, states: Array, actions: Array, noise: Array) -> Array:
        """Return the next states; ``noise`` holds standard normal draws, shape (rows, noise_dim)."""

    @abstractmethod
    def reward(self, states: Array, actions: Array) -> Array:
        """Return the reward of each row, shape (rows,), of acting in these states."""

    def observe(self, states: Array, noise: Array) -> Array:
        """Return the observations of the states: the states themselves unless a task hides something.

        Args:
            states: shape (rows, state_dim).
            noise: standard normal draws, shape (rows, observation_noise_dim).
        """
        return states.copy()

    def draw(self, axes: Axes, state: Array, action: Array) -> None:
        """Draw a moment, for a film of an episode.

        Args:
            axes: to draw in, empty.
            state: shape (state_dim,).
            action: within its bounds, shape (n,).
        """
        raise ValueError(f"{type(self).__name__}: expected a task that draws itself, got one without a method draw")

    def joint_states(self) -> JointStates | None:
        """Return what the robot of the first row did in the step just made; None for nothing, or no robot."""
        return None

    def robot_description(self) -> str | None:
        """Return the robot's URDF; None where there is no robot."""
        return None

    @property
    def states(self) -> Array:
        """The states of the rows, shape (rows, state_dim)."""
        return self._states

    def reset(
        self, *, seed: int | list[int] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Array, dict[str, Any]]:
        """Start an episode in every row.

        Args:
            seed: a seed for each row, or one number from which row i takes ``seed + i``, or None to go on
                with the streams as they are.
            options: none are known.
        """
        if seed is not None or not self._streams:
            self._streams = [seeding.np_random(s)[0] for s in self._row_seeds(seed)]
        first = np.stack([stream.standard_normal(self.observation_noise_dim) for stream in self._streams])
        self._noise: Array = np.empty((0, self.num_envs, self.noise_dim + self.observation_noise_dim))
        self._noise_used = 0
        self._states = self.initial_states(self.num_envs)
        self._step = 0
        return self.observe(self._states, first), {}

    def step(self, actions: Array) -> tuple[Array, Any, Any, Any, dict[str, Any]]:
        """Make one step in every row."""
        clipped = clip(actions, *self._action_bounds)
        draws = self._next_noise()
        noise, observation_noise = draws[:, : self.noise_dim], draws[:, self.noise_dim :]
        if self._step == self.max_episode_steps:
            self._step = 0
            self._states, rewards = self.initial_states(self.num_envs), np.zeros(self.num_envs)
        else:
            self._step += 1
            rewards = self.reward(self._states, clipped)
            self._states = self.transition(self._states, clipped, noise)
        truncated = np.zeros(self.num_envs, dtype=bool)
        truncated[:] = self._step == self.max_episode_steps
        return (
            self.observe(self._states, observation_noise),
            rewards,
            np.zeros(self.num_envs, dtype=bool),
            truncated,
            {},
        )

    def _next_noise(self) -> Array:
        """Return the draws of a step; they are made in blocks, which is faster and changes none of them."""
        if self._noise_used == len(self._noise):
            shape = (NOISE_BLOCK, self.noise_dim + self.observation_noise_dim)
            self._noise = np.stack([stream.standard_normal(shape) for stream in self._streams], axis=1)
            self._noise_used = 0
        self._noise_used += 1
        return np.asarray(self._noise[self._noise_used - 1])

    def _row_seeds(self, seed: int | list[int] | None) -> list[int | None]:
        if seed is None:
            return [None] * self.num_envs
        if isinstance(seed, int):
            return [seed + row for row in range(self.num_envs)]
        if len(seed) != self.num_envs:
            raise ValueError(f"seeds: expected {self.num_envs}, one for each row, got {len(seed)}")
        return list(seed)


class SingleTask(gymnasium.Env[Array, Array]):
    """One row of a vector task as an ordinary Gymnasium environment.

    Args:
        task: a vector task of one row that never truncates; Gymnasium's time limit does.
    """

    metadata: dict[str, Any] = {"render_modes": []}

    def __init__(self, task: VectorTask) -> None:
        self.task = task
        self.observation_space = task.single_observation_space
        self.action_space = task.single_action_space

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Array, dict[str, Any]]:
        """Start an episode."""
        super().reset(seed=seed)
        observations, info = self.task.reset(seed=seed, options=options)
        return observations[0], info

    def step(self, action: Array) -> tuple[Array, float, bool, bool, dict[str, Any]]:
        """Make one step."""
        observations, rewards, _, _, info = self.task.step(np.asarray(action)[None])
        return observations[0], float(rewards[0]), False, False, info
