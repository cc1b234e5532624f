"""A ball on a beam, which an actuator tilts."""

import numpy as np
from gymnasium.spaces import Box
from scipy.special import ndtr

from sim_nodes.envs.drawn_task import DrawnTask
from sim_nodes.envs.scene import BLUE, DARK, GREEN, PALE, Body, BodyTrajectories, Corner, upright
from sim_nodes.envs.vector_task import Array, Flags, clip

HALF = 0.5  # m, of the beam's length
START = np.array([0.3, 0.2, 0.05])  # greatest position (m), velocity (m/s) and angle (rad) at the start
RADIUS = 0.04  # m, of the drawn ball
FALL = 6.0  # is subtracted from the reward of the step in which the ball falls off


class BallOnBeam(DrawnTask):
    r"""Roll a ball to the middle of a beam and keep it there, at 50 Hz; the observation is the state.

    The state is the position :math:`x` of the ball, its velocity :math:`v` and the angle :math:`\phi` of the beam. The
    action in [-1, 1] turns the beam by up to 1.5 rad/s, within 0.3 rad:

    .. math:: \dot v = -\tfrac{5}{7} g \sin\phi - 0.2 v, \qquad r = -0.02 (x / 0.3)^2 - 0.001 a^2

    in steps of 0.01 s. The states start with a uniform distribution. The ball falls off at :math:`|x| > 0.5`, which
    ends the episode and costs 6. There is no noise.
    """

    single_observation_space = Box(-np.inf, np.inf, (3,), np.float64)
    single_action_space = Box(-1.0, 1.0, (1,), np.float64)
    observation_names = ("position (m)", "velocity (m/s)", "angle of the beam (rad)")
    action_names = ("rate of the angle (1.5 rad/s)",)
    noise_dim = 0
    start_noise_dim = 3
    step_seconds = 0.02

    def initial_states(self, num_envs: int) -> Array:
        """Return the state of rest in the middle, the centre of the initial states."""
        return np.zeros((num_envs, 3))

    def random_initial_states(self, noise: Array) -> Array:  # noqa: D102
        return np.asarray(START * (2.0 * ndtr(noise) - 1.0))

    def transition(self, states: Array, actions: Array, noise: Array) -> Array:  # noqa: D102
        x, v, angle = np.ascontiguousarray(states.T)
        for _ in range(2):
            v = v + (-5 / 7 * 9.81 * np.sin(angle) - 0.2 * v) * 0.01
            x = x + v * 0.01
            angle = clip(angle + 1.5 * actions[:, 0] * 0.01, -0.3, 0.3)
        return np.stack([x, v, angle], axis=1)

    def reward(self, states: Array, actions: Array) -> Array:  # noqa: D102
        after = self.transition(states, actions, np.empty((len(states), 0)))
        usual = -((states[:, 0] / 0.3) ** 2) * 0.02 - 0.001 * actions[:, 0] * actions[:, 0]
        return np.asarray(usual - FALL * self.terminations(after))

    def terminations(self, states: Array) -> Flags:  # noqa: D102
        return np.abs(states[:, 0]) > HALF

    def view_direction(self) -> Corner:
        """Return the direction from the task towards the viewer."""
        return (0.0, -1.0, 0.2)

    def bounds(self) -> tuple[Corner, Corner]:
        """Return the corners of the box in which the beam and the ball move."""
        return (-0.6, -0.1, -0.3), (0.6, 0.1, 0.3)

    def bodies(self) -> list[Body]:
        """Return the beam, its bearing, the target in its middle, and the ball."""
        beam, size = Body("box", (2 * HALF, 0.05, 0.01), PALE), 2 * RADIUS
        return [
            beam,
            Body("box", (0.03, 0.05, 0.2), DARK),
            Body("box", (0.02, 0.06, 0.012), GREEN),
            Body("ball", (size, size, size), BLUE),
        ]

    def motion(self, observations: Array, actions: Array) -> BodyTrajectories:
        """Return the bodies' trajectories in an episode."""
        x, _, angle = observations.T
        zero, up = 0 * x, RADIUS + 0.005
        along = np.stack([zero, zero, zero, x * np.cos(angle) - up * np.sin(angle)], axis=1)
        heights = np.stack([zero, zero - 0.11, zero, x * np.sin(angle) + up * np.cos(angle)], axis=1)
        positions = np.stack([along, 0 * along, heights], axis=2)
        orientations = np.array(upright(positions))
        for body in (0, 2):
            orientations[:, body, 0], orientations[:, body, 2] = np.cos(angle / 2), -np.sin(angle / 2)
        return BodyTrajectories(self.step_seconds * np.arange(len(x), dtype=np.float64), positions, orientations)
