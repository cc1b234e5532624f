"""Base classes: a task as a Gymnasium vector environment, with pictures, and as a single environment."""

from abc import abstractmethod
from collections.abc import Mapping
from typing import Any, ClassVar

import gymnasium
import numpy as np
from gymnasium.utils import seeding
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from sim_nodes.envs.scene import Array, Body, BodyTrajectories, Camera, Corner, Pixels

Flags = NDArray[np.bool_]

NOISE_BLOCK = 128  # steps
NEVER = -1  # is no number of steps
SLOWEST = 5  # least frames per second of a video


def clip(values: Array, low: Array | float, high: Array | float) -> Array:
    """Clip values to bounds; several times faster than `numpy.clip` on few values."""
    return np.minimum(np.maximum(values, low), high)


def wrapped(angle: Array) -> Array:
    """Return angles within [-pi, pi)."""
    turned = (angle + np.pi) % (2 * np.pi) - np.pi
    return np.where(turned < np.pi, turned, -np.pi)  # the remainder of a tiny negative number rounds up


class VectorTask(VectorEnv[Array, Array, Any]):
    """Environments of one task that are stepped together, each with its own random stream.

    A subclass defines the spaces, the number of noise draws per transition, and four vectorised formulas. Actions are
    clipped to their space. The step after the last one of an episode resets its environment.

    Args:
        num_envs: number of environments.
        max_episode_steps: steps after which an episode is truncated; None for never.
        render_mode: one of the task's ``render_modes``; None for no pictures.
    """

    metadata: dict[str, Any] = {"autoreset_mode": AutoresetMode.NEXT_STEP, "render_modes": []}
    single_observation_space: Any
    single_action_space: Any
    noise_dim: int  # standard normal draws per transition
    observation_noise_dim: int = 0  # standard normal draws per observation
    start_noise_dim: int = 0  # standard normal draws per initial state
    step_seconds: float = 1.0  # duration of a step
    reference_returns: ClassVar[dict[str, float]] = {}  # at the registered horizon and discount 0.99
    return_options: ClassVar[frozenset[str]] = frozenset()  # options with which the reference returns do not hold
    observation_names: tuple[str, ...] = ()  # of each dimension, with its unit, for figures
    action_names: tuple[str, ...] = ()

    def __init__(self, num_envs: int = 1, max_episode_steps: int | None = None, render_mode: str | None = None) -> None:
        modes = self.metadata["render_modes"]
        if render_mode is not None and render_mode not in modes:
            raise ValueError(f"render_mode: expected one of {', '.join(modes) or 'none'}, got {render_mode!r}")
        self.render_mode = render_mode
        self.num_envs = num_envs
        self.max_episode_steps = max_episode_steps
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        # One per environment: arrays of equal shapes are faster to compare than broadcast ones.
        actions: Any = self.action_space
        self._action_bounds: tuple[Array, Array] = actions.low, actions.high
        self._streams: list[np.random.Generator] = []

    @classmethod
    def time_limit(cls, options: Mapping[str, Any]) -> int | None:
        """Return the steps after which the task itself truncates an episode, given its options; None for never.

        Only a task whose options change the number of steps defines it, and is registered without a time limit.
        """
        return None

    @abstractmethod
    def initial_states(self, noise: Array) -> Array:
        """Return the states at the start of episodes, shape (num_envs, state_dim).

        Args:
            noise: standard normal draws, shape (num_envs, start_noise_dim).
        """

    def terminations(self, states: Array) -> Flags:
        """Return whether these states end the episode, shape (num_envs,); by default none does."""
        return np.zeros(len(states), dtype=bool)

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
        starts = self._starts(np.ones(self.num_envs, dtype=bool))
        first = np.stack([stream.standard_normal(self.observation_noise_dim) for stream in self._streams])
        self._noise: Array = np.empty((0, self.num_envs, self.noise_dim + self.observation_noise_dim))
        self._noise_used = 0
        self._states = starts
        self._steps = np.zeros(self.num_envs, dtype=np.int64)  # of each environment's episode so far
        self._over = np.zeros(self.num_envs, dtype=bool)
        return self.observe(self._states, first), {}

    def step(self, actions: Array) -> tuple[Array, Any, Any, Any, dict[str, Any]]:
        """Make one step in every environment."""
        clipped = clip(actions, *self._action_bounds)
        draws = self._next_noise()
        noise, observation_noise = draws[:, : self.noise_dim], draws[:, self.noise_dim :]
        rewards = self._advance(clipped, noise)
        terminated = self.terminations(self._states)
        truncated = self._steps == (self.max_episode_steps or NEVER)
        self._over = terminated | truncated
        return self.observe(self._states, observation_noise), rewards, terminated, truncated, {}

    def _advance(self, actions: Array, noise: Array) -> Array:
        """Move each environment to its next state, or to an initial one if its episode is over; return the rewards."""
        self._steps += 1
        over = self._over
        restarting = np.count_nonzero(over)
        if restarting < self.num_envs:
            rewards = self.reward(self._states, actions)
            states = self.transition(self._states, actions, noise)
        else:  # no transition, because it may be expensive
            rewards, states = np.zeros(self.num_envs), self._states.copy()
        if restarting:
            states[over], rewards[over], self._steps[over] = self._starts(over), 0.0, 0
        self._states = states
        return rewards

    def _starts(self, which: Flags) -> Array:
        """Return initial states of the given environments, from their own streams."""
        streams = [stream for stream, used in zip(self._streams, which, strict=True) if used]
        return self.initial_states(np.stack([stream.standard_normal(self.start_noise_dim) for stream in streams]))

    def _next_noise(self) -> Array:
        """Return the draws of a step; drawing them in blocks is faster and gives the same numbers."""
        if self._noise_used == len(self._noise):
            shape = (NOISE_BLOCK, self.noise_dim + self.observation_noise_dim)
            self._noise = np.stack([stream.standard_normal(shape) for stream in self._streams], axis=1)
            self._noise_used = 0
        self._noise_used += 1
        return np.asarray(self._noise[self._noise_used - 1])

    def _seeds(self, seed: int | list[int] | None) -> list[Any]:
        seeds = seed if isinstance(seed, list) else [seed if seed is None else seed + i for i in range(self.num_envs)]
        if len(seeds) != self.num_envs:
            raise ValueError(f"seeds: expected {self.num_envs}, one for each environment, got {len(seeds)}")
        return seeds


class DrawnTask(VectorTask):
    """A task that shows its states and actions as bodies.

    Its pictures, with the render mode "rgb_array", show the current state and the action that led to it.
    """

    metadata = {**VectorTask.metadata, "render_modes": ["rgb_array"]}
    view_direction: Corner  # from the task towards the viewer
    bounds: tuple[Corner, Corner]  # corners of the box that a picture shows, m

    def __init__(self, num_envs: int = 1, max_episode_steps: int | None = None, render_mode: str | None = None) -> None:
        super().__init__(num_envs, max_episode_steps, render_mode)
        self.metadata = {**self.metadata, "render_fps": max(round(1.0 / self.step_seconds), SLOWEST)}
        self._actions = np.zeros((num_envs, *self.single_action_space.shape))

    @abstractmethod
    def bodies(self) -> list[Body]:
        """Return the visible bodies."""

    @abstractmethod
    def poses(self, observations: Array, actions: Array) -> tuple[Array, Array]:
        """Return the poses of the bodies before each action of an episode.

        Args:
            observations: before each action, shape (steps, d).
            actions: within their bounds, shape (steps, n).

        Returns:
            The positions of the centres in metres, shape (steps, bodies, 3), and the orientations as unit quaternions
            w, x, y, z, shape (steps, bodies, 4).
        """

    def motion(self, observations: Array, actions: Array) -> BodyTrajectories | None:
        """Return the trajectories of the bodies in an episode, see `poses`; None if nothing moved."""
        times = self.step_seconds * np.arange(len(observations), dtype=np.float64)
        return BodyTrajectories(times, *self.poses(observations, actions))

    def reset(self, **options: Any) -> tuple[Array, dict[str, Any]]:
        """Start an episode in every environment, as in `VectorTask.reset`."""
        self._actions = np.zeros_like(self._actions)
        return super().reset(**options)

    def _advance(self, actions: Array, noise: Array) -> Array:
        rewards = super()._advance(actions, noise)
        self._actions = np.where(self._steps[:, None] > 0, actions, 0.0)  # none led to an initial state
        return rewards

    def render(self) -> tuple[Pixels, ...] | None:
        """Return the picture of each environment, shape (height, width, 3); None without a render mode."""
        if self.render_mode is None:
            return None
        seen = self.observe(self._states, np.zeros((self.num_envs, self.observation_noise_dim)))
        camera, bodies, moments = (
            Camera(self.view_direction, self.bounds),
            self.bodies(),
            self.poses(seen, self._actions),
        )
        return tuple(camera.picture(bodies, *moment) for moment in zip(*moments, strict=True))


class SingleTask(gymnasium.Env[Array, Array]):
    """A vector task of one environment as a single Gymnasium environment.

    Gymnasium's time limit truncates it, unless its options change the number of steps.
    """

    def __init__(self, task: VectorTask) -> None:
        self.task = task
        self.metadata, self.render_mode = task.metadata, task.render_mode
        self.observation_space = task.single_observation_space
        self.action_space = task.single_action_space

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Array, dict[str, Any]]:
        """Start an episode."""
        super().reset(seed=seed)
        observations, info = self.task.reset(seed=seed, options=options)
        return observations[0], info

    def step(self, action: Array) -> tuple[Array, float, bool, bool, dict[str, Any]]:
        """Make one step."""
        observations, rewards, terminated, truncated, info = self.task.step(np.asarray(action)[None])
        info = {name: values[0].item() for name, values in info.items()}
        return observations[0], float(rewards[0]), bool(terminated[0]), bool(truncated[0]), info

    def render(self) -> Any:
        """Return the picture of the current state, or the pictures since the last call."""
        frames = self.task.render()
        return None if frames is None else frames[0]

    def close(self) -> None:
        """Close the task."""
        self.task.close()
