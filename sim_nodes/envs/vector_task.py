"""Base classes: a task as a Gymnasium vector environment, and as a single environment."""

from __future__ import annotations

from abc import abstractmethod
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple

import gymnasium
import numpy as np
from gymnasium.utils import seeding
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

if TYPE_CHECKING:  # a node draws nothing, so it need not import it
    from matplotlib.axes import Axes

Array = NDArray[np.float64]

NOISE_BLOCK = 128  # steps
BLUE, ORANGE, GREEN = "#0072B2", "#D55E00", "#009E73"  # distinguishable for colour-blind viewers
DARK, PALE = "#26262B", "#CCCCCC"


def clip(values: Array, low: Array | float, high: Array | float) -> Array:
    """Clip values to bounds; several times faster than `numpy.clip` on few values."""
    return np.minimum(np.maximum(values, low), high)


class JointStates(NamedTuple):
    """A motion of a robot's joints.

    Attributes:
        names: of the joints.
        positions: in radians or metres, shape (k, joints).
        period: seconds between successive positions.
    """

    names: tuple[str, ...]
    positions: Array
    period: float


class Body(NamedTuple):
    """A visible rigid body.

    Attributes:
        shape: "box", "ball" or "cylinder", whose axis is z.
        size: along x, y and z, in metres.
        colour: red, green and blue, such as "#0072B2".
    """

    shape: str
    size: tuple[float, float, float]
    colour: str


class BodyTrajectories(NamedTuple):
    """Trajectories of bodies; z is up.

    Attributes:
        times: of each moment, in seconds, shape (k,).
        positions: of the centres, in metres, shape (k, bodies, 3).
        orientations: unit quaternions w, x, y, z, shape (k, bodies, 4).
    """

    times: Array
    positions: Array
    orientations: Array


def upright(positions: Array) -> Array:
    """Return identity orientations for positions of shape (k, bodies, 3)."""
    return np.broadcast_to([1.0, 0.0, 0.0, 0.0], (*positions.shape[:2], 4))


class VectorTask(VectorEnv[Array, Array, Any]):
    """Environments of one task that are stepped together, each with its own random stream.

    A subclass defines the spaces, the number of noise draws per transition, and four vectorised formulas. Actions are
    clipped to their space. All environments are always at the same step; the step after the last one resets them.

    Args:
        num_envs: number of environments.
        max_episode_steps: steps after which an episode is truncated; None for never.
    """

    metadata: dict[str, Any] = {"autoreset_mode": AutoresetMode.NEXT_STEP, "render_modes": []}
    single_observation_space: Any
    single_action_space: Any
    noise_dim: int  # standard normal draws per transition
    observation_noise_dim: int = 0  # standard normal draws per observation
    step_seconds: float = 1.0  # duration of a step
    reference_returns: ClassVar[dict[str, float]] = {}  # at the registered horizon and discount 0.99
    observation_names: ClassVar[tuple[str, ...]] = ()  # of each dimension, with its unit, for figures
    action_names: ClassVar[tuple[str, ...]] = ()

    def __init__(self, num_envs: int = 1, max_episode_steps: int | None = None) -> None:
        self.num_envs = num_envs
        self.max_episode_steps = max_episode_steps
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        # One per environment: arrays of equal shapes are faster to compare than broadcast ones.
        actions: Any = self.action_space
        self._action_bounds: tuple[Array, Array] = actions.low, actions.high
        self._streams: list[np.random.Generator] = []

    @abstractmethod
    def initial_states(self, num_envs: int) -> Array:
        """Return the states at the start of an episode, shape (num_envs, state_dim)."""

    @abstractmethod
    def transition(self, states: Array, actions: Array, noise: Array) -> Array:
        """Return the next states; ``noise`` has standard normal draws, shape (num_envs, noise_dim)."""

    @abstractmethod
    def reward(self, states: Array, actions: Array) -> Array:
        """Return the rewards of actions in these states, shape (num_envs,)."""

    def observe(self, states: Array, noise: Array) -> Array:
        """Return the observations of the states; by default the states themselves.

        Args:
            states: shape (num_envs, state_dim).
            noise: standard normal draws, shape (num_envs, observation_noise_dim).
        """
        return states.copy()

    def draw(self, axes: Axes, state: Array, action: Array) -> None:
        """Draw one step, for a film of an episode.

        Args:
            axes: empty axes to draw in.
            state: shape (state_dim,).
            action: within its bounds, shape (n,).
        """
        raise ValueError(f"{type(self).__name__}: expected a task with a method draw, got one without")

    def joint_states(self) -> JointStates | None:
        """Return the robot's motion in the last step of the first environment; None if there is none."""
        return None

    def robot_description(self) -> str | None:
        """Return the robot's URDF; None if there is no robot."""
        return None

    @property
    def states(self) -> Array:
        """The current states, shape (num_envs, state_dim)."""
        return self._states

    def reset(
        self, *, seed: int | list[int] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Array, dict[str, Any]]:
        """Start an episode in every environment.

        Args:
            seed: a seed for each environment, or one number, from which environment i gets ``seed + i``, or None to
                continue the random streams.
            options: ignored.
        """
        if seed is not None or not self._streams:
            self._streams = [seeding.np_random(s)[0] for s in self._seeds(seed)]
        first = np.stack([stream.standard_normal(self.observation_noise_dim) for stream in self._streams])
        self._noise: Array = np.empty((0, self.num_envs, self.noise_dim + self.observation_noise_dim))
        self._noise_used = 0
        self._states = self.initial_states(self.num_envs)
        self._step = 0
        return self.observe(self._states, first), {}

    def step(self, actions: Array) -> tuple[Array, Any, Any, Any, dict[str, Any]]:
        """Make one step in every environment."""
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
        """Return the draws of a step; drawing them in blocks is faster and gives the same numbers."""
        if self._noise_used == len(self._noise):
            shape = (NOISE_BLOCK, self.noise_dim + self.observation_noise_dim)
            self._noise = np.stack([stream.standard_normal(shape) for stream in self._streams], axis=1)
            self._noise_used = 0
        self._noise_used += 1
        return np.asarray(self._noise[self._noise_used - 1])

    def _seeds(self, seed: int | list[int] | None) -> list[int | None]:
        if seed is None:
            return [None] * self.num_envs
        if isinstance(seed, int):
            return [seed + index for index in range(self.num_envs)]
        if len(seed) != self.num_envs:
            raise ValueError(f"seeds: expected {self.num_envs}, one for each environment, got {len(seed)}")
        return list(seed)


class SingleTask(gymnasium.Env[Array, Array]):
    """A vector task of one environment as a single Gymnasium environment.

    Args:
        task: a vector task of one environment that never truncates; Gymnasium's time limit does.
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
