"""A task with a 3D scene, which viewers show and ``render`` draws."""

from abc import abstractmethod
from typing import Any

import numpy as np

from sim_nodes.envs.scene import Body, BodyTrajectories, Camera, Corner, Pixels
from sim_nodes.envs.vector_task import Array, VectorTask

SLOWEST = 5  # least frames per second of a video


class DrawnTask(VectorTask):
    """A task that shows its states and actions as bodies.

    Its pictures, with the render mode "rgb_array", show the current state and the action that led to it.

    Args:
        num_envs: number of environments.
        max_episode_steps: steps after which an episode is truncated; None for never.
        render_mode: "rgb_array" for pictures; None for none.
    """

    metadata = {**VectorTask.metadata, "render_modes": ["rgb_array"]}

    def __init__(self, num_envs: int = 1, max_episode_steps: int | None = None, render_mode: str | None = None) -> None:
        super().__init__(num_envs, max_episode_steps, render_mode)
        self.metadata = {**self.metadata, "render_fps": max(round(1.0 / self.step_seconds), SLOWEST)}
        self._actions = np.zeros((num_envs, *self.single_action_space.shape))

    @abstractmethod
    def view_direction(self) -> Corner:
        """Return the direction from the task towards the viewer."""

    @abstractmethod
    def bounds(self) -> tuple[Corner, Corner]:
        """Return the corners of the box that a picture shows, in metres."""

    @abstractmethod
    def bodies(self) -> list[Body]:
        """Return the visible bodies."""

    @abstractmethod
    def motion(self, observations: Array, actions: Array) -> BodyTrajectories | None:
        """Return the trajectories of the bodies in an episode; None if nothing moved.

        Args:
            observations: before each action, shape (steps, d).
            actions: within their bounds, shape (steps, n).
        """

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
        motion = self.motion(seen, self._actions)
        if motion is None:
            raise ValueError(f"{type(self).__name__}: expected a motion to draw, got none")
        camera, bodies = Camera(self.view_direction(), self.bounds()), self.bodies()
        return tuple(
            camera.picture(bodies, *moment) for moment in zip(motion.positions, motion.orientations, strict=True)
        )
