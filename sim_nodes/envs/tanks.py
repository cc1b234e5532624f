"""Two tanks in series, the first of which a pump fills."""

import numpy as np
from gymnasium.spaces import Box
from scipy.special import ndtr

from sim_nodes.envs.drawn_task import DrawnTask
from sim_nodes.envs.scene import BLUE, DARK, GREEN, ORANGE, PALE, Body, BodyTrajectories, Corner, upright
from sim_nodes.envs.vector_task import Array, clip

LOWEST, HIGHEST = np.array([0.1, 0.1, 0.2]), np.array([0.6, 0.6, 0.7])  # m, of levels and set point at the start
FULL = 1.5  # m
SLICES = 30  # of water in a drawn tank


class Tanks(DrawnTask):
    r"""Bring the level of the second of two tanks to a set point, at 1 Hz; the observation is the state.

    The state is the levels :math:`h_1, h_2` and the set point :math:`t`, which is constant in an episode. The pump's
    action :math:`a` is in [0, 1]:

    .. math:: \dot h_1 = 0.15 a - 0.12 \sqrt{h_1}, \qquad \dot h_2 = 0.12 \sqrt{h_1} - 0.1 \sqrt{h_2}, \qquad
        r = -|h_2 - t|

    in steps of 0.2 s, with levels in [0, 1.5] m. The states start with a uniform distribution. There is no noise.
    """

    single_observation_space = Box(-np.inf, np.inf, (3,), np.float64)
    single_action_space = Box(0.0, 1.0, (1,), np.float64)
    observation_names = ("first level (m)", "second level (m)", "set point (m)")
    action_names = ("pump",)
    noise_dim = 0
    start_noise_dim = 3
    step_seconds = 1.0

    def initial_states(self, num_envs: int) -> Array:
        """Return the centre of the initial states."""
        return np.tile((LOWEST + HIGHEST) / 2, (num_envs, 1))

    def random_initial_states(self, noise: Array) -> Array:  # noqa: D102
        return np.asarray(LOWEST + (HIGHEST - LOWEST) * ndtr(noise))

    def transition(self, states: Array, actions: Array, noise: Array) -> Array:  # noqa: D102
        first, second, target = np.ascontiguousarray(states.T)
        for _ in range(5):
            between, out = 0.12 * np.sqrt(first), 0.1 * np.sqrt(second)
            first = clip(first + 0.2 * (0.15 * actions[:, 0] - between), 0.0, FULL)
            second = clip(second + 0.2 * (between - out), 0.0, FULL)
        return np.stack([first, second, target], axis=1)

    def reward(self, states: Array, actions: Array) -> Array:  # noqa: D102
        return -np.abs(states[:, 1] - states[:, 2])

    def view_direction(self) -> Corner:
        """Return the direction from the task towards the viewer."""
        return (0.0, -1.0, 0.25)

    def bounds(self) -> tuple[Corner, Corner]:
        """Return the corners of the box around the tanks."""
        return (-1.0, -0.3, 0.0), (1.0, 0.3, FULL)

    def bodies(self) -> list[Body]:
        """Return the tanks' backs and floors, the water as slices, the set point, and the pump's action."""
        water = [Body("box", (0.5, 0.4, FULL / SLICES), BLUE)] * (2 * SLICES)
        tanks = [Body("box", (0.6, 0.02, FULL), PALE), Body("box", (0.6, 0.5, 0.02), DARK)] * 2
        return [*tanks, *water, Body("box", (0.5, 0.02, 0.02), GREEN), Body("ball", (0.12, 0.12, 0.12), ORANGE)]

    def motion(self, observations: Array, actions: Array) -> BodyTrajectories:
        """Return the bodies' trajectories in an episode; the ball at the left rises with the action of the pump."""
        first, second, target = (column[:, None] for column in observations.T)
        bottom = FULL / SLICES * (np.arange(SLICES) - 0.5)  # of a slice, below the level it fills to
        zero = 0 * first
        levels = [
            np.minimum(np.maximum(level - FULL / SLICES / 2, 0.0), bottom + 0 * level) for level in (first, second)
        ]
        heights = np.concatenate(
            [zero + FULL / 2, zero, zero + FULL / 2, zero, *levels, target, 1.2 * actions[:, :1]], axis=1
        )
        along = np.array([-0.4, -0.4, 0.4, 0.4, *[-0.4] * SLICES, *[0.4] * SLICES, 0.4, -0.85])
        depth = np.array([0.25, 0.0, 0.25, 0.0, *[0.0] * (2 * SLICES), -0.22, 0.0])
        positions = np.stack([along + 0 * heights, depth + 0 * heights, heights], axis=2)
        times = self.step_seconds * np.arange(len(observations), dtype=np.float64)
        return BodyTrajectories(times, positions, upright(positions))
