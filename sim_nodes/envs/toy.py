"""The toy task of Lever and Stafford (2015), section 4.1 of the paper."""

from typing import ClassVar

import numpy as np
from gymnasium.spaces import Box

from sim_nodes.envs.drawn_task import DrawnTask
from sim_nodes.envs.scene import BLUE, GREEN, ORANGE, PALE, Body, BodyTrajectories, upright
from sim_nodes.envs.vector_task import Array, clip

GOAL = 3.0
BEADS = 8  # in the line that visualises the action


class Toy(DrawnTask):
    r"""Move along a line to the point 3.

    .. math:: s_{t+1} = s_t + a_t + \epsilon, \qquad r(s, a) = \exp(-|s - 3|), \qquad s_0 = 0

    State in [-4, 4], action in [-1, 1]. The paper calls the noise "small". Here, its standard deviation is 0.11. The
    optimum is then 14.5, from dynamic programming.
    """

    single_observation_space = Box(-4.0, 4.0, (1,), np.float64)
    single_action_space = Box(-1.0, 1.0, (1,), np.float64)
    observation_names: tuple[str, ...] = ("position",)
    action_names: tuple[str, ...] = ("move",)
    reference_returns: ClassVar[dict[str, float]] = {"optimum (dynamic programming)": 14.5}
    noise_dim = 1
    noise_sd = 0.11

    def initial_states(self, num_envs: int) -> Array:  # noqa: D102
        return np.zeros((num_envs, 1))

    def transition(self, states: Array, actions: Array, noise: Array) -> Array:  # noqa: D102
        return clip(states + actions + self.noise_sd * noise, -4.0, 4.0)

    def reward(self, states: Array, actions: Array) -> Array:  # noqa: D102
        return np.exp(-np.abs(states[:, 0] - GOAL))

    def view_direction(self) -> tuple[float, float, float]:
        """Return the direction from the task towards the viewer."""
        return (0.0, -1.0, 0.2)

    def bounds(self) -> tuple[tuple[float, float, float], tuple[float, float, float]]:
        """Return the corners of the box in which the point moves."""
        return (-5.2, 0.0, -0.3), (5.2, 0.0, 1.0)

    def bodies(self) -> list[Body]:
        """Return the line, the goal, the point, and beads that visualise the action."""
        return [
            Body("box", (8.0, 0.3, 0.06), PALE),
            Body("cylinder", (0.6, 0.6, 0.1), GREEN),
            Body("ball", (0.5, 0.5, 0.5), BLUE),
            *[Body("ball", (size, size, size), ORANGE) for size in [*[0.1] * (BEADS - 1), 0.24]],
        ]

    def motion(self, observations: Array, actions: Array) -> BodyTrajectories:
        """Return the bodies' trajectories in an episode."""
        place = observations[:, :1]
        along = [0 * place, 0 * place + GOAL, place, place + np.linspace(0.0, 1.0, BEADS) * actions[:, :1]]
        x = np.concatenate(along, axis=1)
        height = np.array([-0.05, 0.0, 0.25, *[0.75] * BEADS])
        positions = np.stack([x, 0 * x, np.broadcast_to(height, x.shape)], axis=2)
        return BodyTrajectories(
            self.step_seconds * np.arange(len(place), dtype=np.float64), positions, upright(positions)
        )
