"""The tasks of Lever and Stafford (2015), sections 4.1 and 4.2 of the paper: a toy task and the inverted pendulum."""

from typing import ClassVar

import numpy as np
from gymnasium.spaces import Box

from sim_nodes.envs.scene import BLUE, DARK, GREEN, PALE, Array, Body, beads, in_plane
from sim_nodes.envs.vector_task import DrawnTask, clip, wrapped

GOAL = 3.0
MOVE_BEADS = 8  # in the line that visualises the action


class Toy(DrawnTask):
    r"""Move along a line to the point 3.

    .. math:: s_{t+1} = s_t + a_t + \epsilon, \qquad r(s, a) = \exp(-|s - 3|), \qquad s_0 = 0

    State in [-4, 4], action in [-1, 1]. The paper calls the noise "small". Here, its standard deviation is 0.11. The
    optimum is then 14.5, from dynamic programming.
    """

    single_observation_space = Box(-4.0, 4.0, (1,), np.float64)
    single_action_space = Box(-1.0, 1.0, (1,), np.float64)
    view_direction = (0.0, -1.0, 0.2)
    bounds = (-5.2, 0.0, -0.3), (5.2, 0.0, 1.0)
    observation_names: tuple[str, ...] = ("position",)
    action_names: tuple[str, ...] = ("move",)
    reference_returns: ClassVar[dict[str, float]] = {"optimum (dynamic programming)": 14.5}
    noise_dim = 1
    noise_sd = 0.11

    def initial_states(self, noise: Array) -> Array:  # noqa: D102
        return np.zeros((len(noise), 1))

    def transition(self, states: Array, actions: Array, noise: Array) -> Array:  # noqa: D102
        return clip(states + actions + self.noise_sd * noise, -4.0, 4.0)

    def reward(self, states: Array, actions: Array) -> Array:  # noqa: D102
        return np.exp(-np.abs(states[:, 0] - GOAL))

    def bodies(self) -> list[Body]:
        """Return the line, the goal, the point, and beads that visualise the action."""
        return [
            Body("box", (8.0, 0.3, 0.06), PALE),
            Body("cylinder", (0.6, 0.6, 0.1), GREEN),
            Body("ball", (0.5, 0.5, 0.5), BLUE),
            *beads(MOVE_BEADS, 0.1, 0.24),
        ]

    def poses(self, observations: Array, actions: Array) -> tuple[Array, Array]:  # noqa: D102
        place = observations[:, :1]
        along = [0 * place, 0 * place + GOAL, place, place + np.linspace(0.0, 1.0, MOVE_BEADS) * actions[:, :1]]
        return in_plane(np.concatenate(along, axis=1), 0.0, np.array([-0.05, 0.0, 0.25, *[0.75] * MOVE_BEADS]))


ANGLES = ("clip", "wrap")
HIGH = np.array([[np.pi], [4 * np.pi]])  # of angle and angular velocity
LOW = -HIGH
BEADS = 12  # in the arc that visualises the torque


class Pendulum(DrawnTask):
    r"""Swing up and balance; the observation is the state :math:`(\theta, \omega)`.

    .. math:: \theta' = \theta + 0.05\,\omega + \epsilon, \quad \omega' = \omega + 0.05\,a + 2\epsilon, \quad
        r(s, a) = \exp(-\theta^2 / 2)

    applied twice for each action, from :math:`(-\pi, 0)`, with independent :math:`\epsilon \sim N(0, 0.02^2)`.
    Action in [-3, 3], angular velocity in [-4 pi, 4 pi].

    Args:
        num_envs: number of environments.
        max_episode_steps: steps after which an episode is truncated; None for never.
        angle: at the ends of [-pi, pi] the angle is clipped ("clip") or wraps around ("wrap").
        render_mode: "rgb_array" for pictures; None for none.
    """

    single_observation_space = Box(np.array([-np.pi, -4 * np.pi]), np.array([np.pi, 4 * np.pi]), dtype=np.float64)
    single_action_space = Box(-3.0, 3.0, (1,), np.float64)
    view_direction = (0.0, -1.0, 0.12)
    bounds = (-1.1, 0.0, -1.1), (1.1, 0.0, 1.1)
    observation_names: tuple[str, ...] = ("angle (rad)", "angular velocity (rad/s)")
    action_names: tuple[str, ...] = ("torque",)
    reference_returns: ClassVar[dict[str, float]] = {
        "optimum (dynamic programming)": 51.8,
        "optimum stated in the paper (too low)": 46.0,
        "balanced, according to the paper": 25.0,
    }
    noise_dim = 4
    step_seconds = 0.1
    noise_sd = 0.02
    kick_sds = noise_sd * np.array([[1.0], [2.0], [1.0], [2.0]])  # of angle and angular velocity, twice

    def __init__(
        self,
        num_envs: int = 1,
        max_episode_steps: int | None = None,
        angle: str = "clip",
        render_mode: str | None = None,
    ) -> None:
        if angle not in ANGLES:
            raise ValueError(f"angle: expected one of {', '.join(ANGLES)}, got '{angle}'")
        super().__init__(num_envs, max_episode_steps, render_mode)
        self.angle = angle

    def initial_states(self, noise: Array) -> Array:  # noqa: D102
        return np.tile([-np.pi, 0.0], (len(noise), 1))

    def transition(self, states: Array, actions: Array, noise: Array) -> Array:  # noqa: D102
        columns, kicks = states.T, self.kick_sds * noise.T
        drift = np.empty_like(columns, order="C")
        np.multiply(0.05, actions[:, 0], out=drift[1])
        for kick in (kicks[:2], kicks[2:]):
            np.multiply(0.05, columns[1], out=drift[0])
            columns = columns + drift
            columns += kick
            if self.angle == "wrap":
                columns[0] = wrapped(columns[0])
            columns = clip(columns, LOW, HIGH)
        return columns.T

    def reward(self, states: Array, actions: Array) -> Array:  # noqa: D102
        return np.exp(-0.5 * states[:, 0] ** 2)

    def bodies(self) -> list[Body]:
        """Return the rod, its weight, its bearing, the target position, and the torque as an arc of beads."""
        return [
            Body("cylinder", (0.07, 0.07, 1.0), BLUE),
            Body("ball", (0.2, 0.2, 0.2), BLUE),
            Body("ball", (0.14, 0.14, 0.14), DARK),
            Body("box", (0.02, 0.02, 1.1), PALE),
            *beads(BEADS, 0.05, 0.12),
        ]

    def poses(self, observations: Array, actions: Array) -> tuple[Array, Array]:
        """Return the poses of the bodies; the arc of a torque of 1 is half a radian long."""
        theta = observations[:, :1]
        arc = theta + np.linspace(0.0, 0.5, BEADS) * actions[:, :1]
        angles = np.concatenate([theta, theta, 0 * theta, 0 * theta, arc], axis=1)
        radii = np.array([0.5, 1.0, 0.0, 0.55, *[0.5] * BEADS])
        depth = np.array([0.0, 0.0, 0.0, 0.1, *[-0.12] * BEADS])
        return in_plane(radii * np.sin(angles), depth, radii * np.cos(angles), angles)


class PendulumPOMDP(Pendulum):
    r"""The pendulum with the observation :math:`o = \theta + 2\epsilon`, :math:`\epsilon \sim N(0, 0.02^2)`.

    The velocity must be inferred from a history of observations and actions. With full observation the optimal return
    is 51.8; the optimum of this task is unknown.
    """

    single_observation_space = Box(-np.inf, np.inf, (1,), np.float64)
    observation_names: tuple[str, ...] = ("observed angle (rad)",)
    reference_returns: ClassVar[dict[str, float]] = {
        "optimum with full observation (dynamic programming)": 51.8,
        "balanced, according to the paper": 25.0,
    }
    observation_noise_dim = 1

    def observe(self, states: Array, noise: Array) -> Array:  # noqa: D102
        return states[:, :1] + 2.0 * self.noise_sd * noise
