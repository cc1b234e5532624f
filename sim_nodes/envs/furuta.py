"""The Furuta pendulum: a pole that hangs from the end of a motor's horizontal arm."""

import numpy as np
from gymnasium.spaces import Box

from sim_nodes.envs.drawn_task import DrawnTask
from sim_nodes.envs.scene import BLUE, DARK, GREEN, PALE, Body, BodyTrajectories, Corner, quaternions
from sim_nodes.envs.vector_task import Array, wrapped

MASS, ARM, HALF = 0.024, 0.085, 0.065  # kg, of the pole; m: the arm, and half of the pole
INERTIA, POLE_INERTIA = 1.2e-4, MASS * HALF * HALF * 4 / 3  # kg m2, of the arm and of the pole about its joint
GRAVITY = 9.81
STOP = 2.0  # rad, greatest angle of the arm
START_SD = 0.02  # of each state


class Furuta(DrawnTask):
    r"""Swing up and balance the pole by a torque on the arm, at 100 Hz.

    The state is the angles :math:`\phi` of the arm and :math:`\alpha` of the pole, which is 0 upright, and their
    velocities; the observation is :math:`(\phi, \cos\alpha, \sin\alpha, \dot\phi, \dot\alpha)`. The action in [-1, 1]
    is a torque of up to 0.05 N m. The accelerations solve

    .. math:: \begin{pmatrix} J + m L^2 + J_p s^2 & m L l c \\ m L l c & J_p \end{pmatrix}
        \begin{pmatrix} \ddot\phi \\ \ddot\alpha \end{pmatrix} = \begin{pmatrix}
        T - 5 \cdot 10^{-4} \dot\phi - 2 J_p s c \dot\alpha \dot\phi + m L l s \dot\alpha^2 \\
        J_p s c \dot\phi^2 + m g l s - 2 \cdot 10^{-5} \dot\alpha \end{pmatrix}

    with :math:`s = \sin\alpha, c = \cos\alpha`, in steps of 0.002 s; the arm stops at :math:`|\phi| = 2`. The reward is
    :math:`\exp(-2 \alpha^2 - 0.2 \phi^2)` after the step. The pole starts hanging, with the standard deviation 0.02 of
    each state. There is no other noise.
    """

    single_observation_space = Box(-np.inf, np.inf, (5,), np.float64)
    single_action_space = Box(-1.0, 1.0, (1,), np.float64)
    observation_names = (
        "angle of the arm (rad)",
        "cosine of the pole",
        "sine of the pole",
        "velocity of the arm (rad/s)",
        "velocity of the pole (rad/s)",
    )
    action_names = ("torque (0.05 N m)",)
    noise_dim = 0
    start_noise_dim = 4
    step_seconds = 0.01

    def initial_states(self, num_envs: int) -> Array:
        """Return the state of rest with a hanging pole, without noise."""
        return np.tile([0.0, np.pi, 0.0, 0.0], (num_envs, 1))

    def random_initial_states(self, noise: Array) -> Array:  # noqa: D102
        return START_SD * noise + self.initial_states(len(noise))

    def transition(self, states: Array, actions: Array, noise: Array) -> Array:  # noqa: D102
        arm, pole, arm_speed, pole_speed = np.ascontiguousarray(states.T)
        for _ in range(5):
            turning = self.accelerations(np.stack([arm, pole, arm_speed, pole_speed]), 0.05 * actions[:, 0])
            arm_speed, pole_speed = arm_speed + 0.002 * turning[0], pole_speed + 0.002 * turning[1]
            arm, pole = arm + 0.002 * arm_speed, pole + 0.002 * pole_speed
            arm_speed = np.where(np.abs(arm) > STOP, 0.0, arm_speed)
            arm = np.minimum(np.maximum(arm, -STOP), STOP)
        return np.stack([arm, pole, arm_speed, pole_speed], axis=1)

    def accelerations(self, columns: Array, torque: Array) -> Array:
        """Return the accelerations of arm and pole, shape (2, k), of states of shape (4, k) under torques (k,)."""
        _, pole, dp, da = columns
        s, c, coupling = np.sin(pole), np.cos(pole), MASS * ARM * HALF
        inertia = np.empty((len(pole), 2, 2))
        inertia[:, 0, 0], inertia[:, 1, 1] = INERTIA + MASS * ARM * ARM + POLE_INERTIA * s * s, POLE_INERTIA
        inertia[:, 0, 1] = inertia[:, 1, 0] = coupling * c
        on_arm = torque - 5e-4 * dp - POLE_INERTIA * 2 * s * c * da * dp + coupling * s * da * da
        on_pole = POLE_INERTIA * s * c * dp * dp + MASS * GRAVITY * HALF * s - 2e-5 * da
        return np.linalg.solve(inertia, np.stack([on_arm, on_pole], axis=1)[:, :, None])[:, :, 0].T

    def reward(self, states: Array, actions: Array) -> Array:  # noqa: D102
        arm, pole, _, _ = self.transition(states, actions, np.empty((len(states), 0))).T
        return np.asarray(np.exp(-2.0 * wrapped(pole) ** 2 - 0.2 * arm * arm))

    def observe(self, states: Array, noise: Array) -> Array:  # noqa: D102
        arm, pole, arm_speed, pole_speed = np.ascontiguousarray(states.T)
        return np.stack([arm, np.cos(pole), np.sin(pole), arm_speed, pole_speed], axis=1)

    def view_direction(self) -> Corner:
        """Return the direction from the task towards the viewer, who faces the arm at angle 0."""
        return (1.0, -0.6, 0.5)

    def bounds(self) -> tuple[Corner, Corner]:
        """Return the corners of the box in which arm and pole move."""
        return (-0.15, -0.15, -0.14), (0.15, 0.15, 0.14)

    def bodies(self) -> list[Body]:
        """Return the motor, the arm, the pole and its tip, and the direction of the target."""
        return [
            Body("cylinder", (0.04, 0.04, 0.1), DARK),
            Body("box", (ARM, 0.01, 0.01), PALE),
            Body("box", (0.008, 0.008, 2 * HALF), BLUE),
            Body("ball", (0.022, 0.022, 0.022), BLUE),
            Body("box", (0.006, 0.006, 0.06), GREEN),
        ]

    def motion(self, observations: Array, actions: Array) -> BodyTrajectories:
        """Return the bodies' trajectories in an episode; the target stands on the end of the arm."""
        arm, cosine, sine, _, _ = observations.T
        zero, one = 0 * arm, 0 * arm + 1.0
        out = np.stack([np.cos(arm), np.sin(arm), zero], axis=1)  # along the arm
        beside = np.stack([-np.sin(arm), np.cos(arm), zero], axis=1)
        up = np.stack([zero, zero, one], axis=1)
        along = cosine[:, None] * up - sine[:, None] * beside  # along the pole
        end = ARM * out
        positions = np.stack(
            [-0.055 * up, end / 2, end + HALF * along, end + 2 * HALF * along, end + 0.16 * up], axis=1
        )
        still = np.tile(np.eye(3), (len(arm), 1, 1))
        turned = np.stack([out, beside, up], axis=2)
        leaning = np.stack([out, np.cross(along, out), along], axis=2)
        turns = quaternions(np.stack([still, turned, leaning, leaning, still], axis=1))
        return BodyTrajectories(self.step_seconds * np.arange(len(arm), dtype=np.float64), positions, turns)
