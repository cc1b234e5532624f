"""Three classical control tasks: a ball on a beam, two tanks, and the Furuta pendulum."""

import numpy as np
from gymnasium.spaces import Box
from scipy.special import ndtr

from sim_nodes.envs.scene import BLUE, DARK, GREEN, ORANGE, PALE, Array, Body, in_plane, quaternions
from sim_nodes.envs.vector_task import DrawnTask, Flags, clip, wrapped

BEAM_HALF = 0.5  # m, of the beam's length
BALL_START = np.array([0.3, 0.2, 0.05])  # greatest position (m), velocity (m/s) and angle (rad) at the start
BALL_RADIUS = 0.04  # m, of the drawn ball
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
    view_direction = (0.0, -1.0, 0.2)
    bounds = (-0.6, -0.1, -0.3), (0.6, 0.1, 0.3)
    observation_names = ("position (m)", "velocity (m/s)", "angle of the beam (rad)")
    action_names = ("rate of the angle (1.5 rad/s)",)
    noise_dim = 0
    start_noise_dim = 3
    step_seconds = 0.02

    def initial_states(self, noise: Array) -> Array:  # noqa: D102
        return np.asarray(BALL_START * (2.0 * ndtr(noise) - 1.0))

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
        return np.abs(states[:, 0]) > BEAM_HALF

    def bodies(self) -> list[Body]:
        """Return the beam, its bearing, the target in its middle, and the ball."""
        return [
            Body("box", (2 * BEAM_HALF, 0.05, 0.01), PALE),
            Body("box", (0.03, 0.05, 0.2), DARK),
            Body("box", (0.02, 0.06, 0.012), GREEN),
            Body("ball", (2 * BALL_RADIUS,) * 3, BLUE),
        ]

    def poses(self, observations: Array, actions: Array) -> tuple[Array, Array]:  # noqa: D102
        x, _, angle = observations.T
        zero, up = 0 * x, BALL_RADIUS + 0.005
        along = np.stack([zero, zero, zero, x * np.cos(angle) - up * np.sin(angle)], axis=1)
        heights = np.stack([zero, zero - 0.11, zero, x * np.sin(angle) + up * np.cos(angle)], axis=1)
        return in_plane(along, 0.0, heights, np.stack([-angle, zero, -angle, zero], axis=1))


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
    view_direction = (0.0, -1.0, 0.25)
    bounds = (-1.0, -0.3, 0.0), (1.0, 0.3, FULL)
    observation_names = ("first level (m)", "second level (m)", "set point (m)")
    action_names = ("pump",)
    noise_dim = 0
    start_noise_dim = 3
    step_seconds = 1.0

    def initial_states(self, noise: Array) -> Array:  # noqa: D102
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

    def bodies(self) -> list[Body]:
        """Return the tanks' backs and floors, the water as slices, the set point, and the pump's action."""
        water = [Body("box", (0.5, 0.4, FULL / SLICES), BLUE)] * (2 * SLICES)
        tanks = [Body("box", (0.6, 0.02, FULL), PALE), Body("box", (0.6, 0.5, 0.02), DARK)] * 2
        return [*tanks, *water, Body("box", (0.5, 0.02, 0.02), GREEN), Body("ball", (0.12, 0.12, 0.12), ORANGE)]

    def poses(self, observations: Array, actions: Array) -> tuple[Array, Array]:
        """Return the poses of the bodies; the ball at the left rises with the action of the pump."""
        first, second, target = (column[:, None] for column in observations.T)
        bottom = FULL / SLICES * (np.arange(SLICES) - 0.5)  # of a slice, below the level it fills to
        zero = 0 * first
        levels = [np.minimum(np.maximum(level - FULL / SLICES / 2, 0.0), bottom) for level in (first, second)]
        heights = np.concatenate(
            [zero + FULL / 2, zero, zero + FULL / 2, zero, *levels, target, 1.2 * actions[:, :1]], axis=1
        )
        along = np.array([-0.4, -0.4, 0.4, 0.4, *[-0.4] * SLICES, *[0.4] * SLICES, 0.4, -0.85])
        depth = np.array([0.25, 0.0, 0.25, 0.0, *[0.0] * (2 * SLICES), -0.22, 0.0])
        return in_plane(along, depth, heights)


POLE_MASS, ARM, POLE_HALF = 0.024, 0.085, 0.065  # kg, of the pole; m: the arm, and half of the pole
INERTIA = 1.2e-4  # kg m2, of the arm
POLE_INERTIA = POLE_MASS * POLE_HALF * POLE_HALF * 4 / 3  # kg m2, of the pole about its joint
GRAVITY = 9.81
ARM_STOP = 2.0  # rad, greatest angle of the arm
FURUTA_START_SD = 0.02  # of each state


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
    view_direction = (1.0, -0.6, 0.5)
    bounds = (-0.15, -0.15, -0.14), (0.15, 0.15, 0.14)
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

    def initial_states(self, noise: Array) -> Array:  # noqa: D102
        return np.asarray([0.0, np.pi, 0.0, 0.0] + FURUTA_START_SD * noise)

    def transition(self, states: Array, actions: Array, noise: Array) -> Array:  # noqa: D102
        arm, pole, arm_speed, pole_speed = np.ascontiguousarray(states.T)
        for _ in range(5):
            turning = self.accelerations(np.stack([arm, pole, arm_speed, pole_speed]), 0.05 * actions[:, 0])
            arm_speed, pole_speed = arm_speed + 0.002 * turning[0], pole_speed + 0.002 * turning[1]
            arm, pole = arm + 0.002 * arm_speed, pole + 0.002 * pole_speed
            arm_speed = np.where(np.abs(arm) > ARM_STOP, 0.0, arm_speed)
            arm = np.minimum(np.maximum(arm, -ARM_STOP), ARM_STOP)
        return np.stack([arm, pole, arm_speed, pole_speed], axis=1)

    def accelerations(self, columns: Array, torque: Array) -> Array:
        """Return the accelerations of arm and pole, shape (2, k), of states of shape (4, k) under torques (k,)."""
        _, pole, dp, da = columns
        s, c, coupling = np.sin(pole), np.cos(pole), POLE_MASS * ARM * POLE_HALF
        inertia = np.empty((len(pole), 2, 2))
        inertia[:, 0, 0], inertia[:, 1, 1] = INERTIA + POLE_MASS * ARM * ARM + POLE_INERTIA * s * s, POLE_INERTIA
        inertia[:, 0, 1] = inertia[:, 1, 0] = coupling * c
        on_arm = torque - 5e-4 * dp - POLE_INERTIA * 2 * s * c * da * dp + coupling * s * da * da
        on_pole = POLE_INERTIA * s * c * dp * dp + POLE_MASS * GRAVITY * POLE_HALF * s - 2e-5 * da
        return np.linalg.solve(inertia, np.stack([on_arm, on_pole], axis=1)[:, :, None])[:, :, 0].T

    def reward(self, states: Array, actions: Array) -> Array:  # noqa: D102
        arm, pole, _, _ = self.transition(states, actions, np.empty((len(states), 0))).T
        return np.asarray(np.exp(-2.0 * wrapped(pole) ** 2 - 0.2 * arm * arm))

    def observe(self, states: Array, noise: Array) -> Array:  # noqa: D102
        arm, pole, arm_speed, pole_speed = np.ascontiguousarray(states.T)
        return np.stack([arm, np.cos(pole), np.sin(pole), arm_speed, pole_speed], axis=1)

    def bodies(self) -> list[Body]:
        """Return the motor, the arm, the pole and its tip, and the direction of the target."""
        return [
            Body("cylinder", (0.04, 0.04, 0.1), DARK),
            Body("box", (ARM, 0.01, 0.01), PALE),
            Body("box", (0.008, 0.008, 2 * POLE_HALF), BLUE),
            Body("ball", (0.022, 0.022, 0.022), BLUE),
            Body("box", (0.006, 0.006, 0.06), GREEN),
        ]

    def poses(self, observations: Array, actions: Array) -> tuple[Array, Array]:
        """Return the poses of the bodies; the target stands on the end of the arm."""
        arm, cosine, sine, _, _ = observations.T
        zero, one = 0 * arm, 0 * arm + 1.0
        out = np.stack([np.cos(arm), np.sin(arm), zero], axis=1)  # along the arm
        beside = np.stack([-np.sin(arm), np.cos(arm), zero], axis=1)
        up = np.stack([zero, zero, one], axis=1)
        along = cosine[:, None] * up - sine[:, None] * beside  # along the pole
        end = ARM * out
        positions = np.stack(
            [-0.055 * up, end / 2, end + POLE_HALF * along, end + 2 * POLE_HALF * along, end + 0.16 * up], axis=1
        )
        still = np.tile(np.eye(3), (len(arm), 1, 1))
        turned = np.stack([out, beside, up], axis=2)
        leaning = np.stack([out, np.cross(along, out), along], axis=2)
        return positions, quaternions(np.stack([still, turned, leaning, leaning, still], axis=1))
