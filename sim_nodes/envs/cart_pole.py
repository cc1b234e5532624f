"""The cart-pole swing-up of PILCO (Deisenroth, 2010) and MC-PILCO (Amadio et al., 2022)."""

from collections.abc import Mapping
from math import ceil
from typing import Any, ClassVar

import numpy as np
from gymnasium.spaces import Box

from sim_nodes.envs.scene import BLUE, DARK, GREEN, PALE, Array, Body, beads, in_plane
from sim_nodes.envs.vector_task import DrawnTask, Flags, wrapped

SECONDS = 3.0  # of an episode
USUAL_RATE = 20.0  # Hz
SUBSTEP = 0.005  # s, at most; ten per step at the usual rate
START_SD = 0.01  # of each state
USUAL_WIDTH = 3.0  # rad
REACH = 0.5  # m, of the tip of the pole from its joint
DRAWN_HALF = 1.0  # m, of the drawn rail on each side if the task has no limit
FLOOR = -0.62  # m
METRES_PER_NEWTON = 0.05  # of the row of beads that visualises the force
BEADS = 8
CART_SIZE = (0.3, 0.16, 0.12)  # m
HIGHEST = np.array([np.inf, np.inf, 1.0, 1.0, np.inf])


class CartPole(DrawnTask):
    r"""Swing up a pole on a cart by a force on the cart, and balance it over the middle of the rail.

    The state is :math:`(x, v, \theta, \omega)`. The angle is 0 if the pole hangs, and the tip of the pole is at
    :math:`x + l \sin\theta`. With the force :math:`F` in [-10, 10] N:

    .. math:: \dot v = \frac{2 m l \omega^2 \sin\theta + 3 m g \sin\theta\cos\theta + 4 (F - b v)}{d}, \quad
        \dot\omega = -\frac{3 m l \omega^2 \sin\theta\cos\theta + 6 (M + m) g \sin\theta + 6 (F - b v) \cos\theta}{l d}

    with :math:`d = 4 (M + m) - 3 m \cos^2\theta`, in Runge-Kutta steps of at most 5 ms. Each state starts with the
    standard deviation 0.01 around rest. The reward of a step is :math:`\exp(-(u / 3)^2 - x^2)`, with the angle
    :math:`u` from upright, in [0, pi] rad. There is no other noise. An episode is truncated after 3 s.

    Args:
        num_envs: number of environments.
        max_episode_steps: steps after which an episode is truncated, if these are less than 3 s; None for 3 s.
        rate: steps per second. The reward of a step is multiplied by 20 / rate, so that the undiscounted return hardly
            depends on the rate.
        rail: greatest distance of the cart from the middle, in metres; an episode terminates beyond it. None for no
            limit.
        reward_width: replaces the 3 rad in the reward; the width along the rail, 1 m, changes in proportion.
        render_mode: "rgb_array" for pictures; None for none.
    """

    mass = 0.5  # m, of the pole, kg
    cart_mass = 0.5  # M, kg
    length = REACH  # l, m
    friction = 0.1  # b, of the cart, N s/m
    gravity = 9.82  # g, m/s^2

    single_observation_space = Box(-HIGHEST, HIGHEST, dtype=np.float64)
    single_action_space = Box(-10.0, 10.0, (1,), np.float64)
    view_direction = (0.0, -1.0, 0.2)
    bounds = (-DRAWN_HALF - REACH, -0.1, -REACH), (DRAWN_HALF + REACH, 0.1, REACH)
    observation_names = (
        "cart position (m)",
        "cart velocity (m/s)",
        "cosine of the angle",
        "sine of the angle",
        "angular velocity (rad/s)",
    )
    action_names = ("force (N)",)
    reference_returns: ClassVar[dict[str, float]] = {"best known (trajectory optimisation)": 38.1}
    return_options: ClassVar[frozenset[str]] = frozenset({"rate", "rail", "reward_width"})
    noise_dim = 0
    start_noise_dim = 4

    def __init__(
        self,
        num_envs: int = 1,
        max_episode_steps: int | None = None,
        rate: float = USUAL_RATE,
        rail: float | None = None,
        reward_width: float = USUAL_WIDTH,
        render_mode: str | None = None,
    ) -> None:
        for name, value in (("rail", rail), ("reward_width", reward_width)):
            if value is not None and not value > 0:
                raise ValueError(f"{name}: expected a positive number, got {value!r}")
        steps = self.time_limit({"rate": rate})
        self.rate, self.rail, self.reward_width = float(rate), rail, float(reward_width)
        self.step_seconds = 1.0 / self.rate
        half = (rail or DRAWN_HALF) + REACH
        self.bounds = (-half, -0.1, -REACH), (half, 0.1, REACH)  # without a rail, the cart may leave it
        super().__init__(num_envs, min(steps, max_episode_steps or steps), render_mode)

    @classmethod
    def time_limit(cls, options: Mapping[str, Any]) -> int:
        """Return the steps in 3 s at the rate in the options.

        Raises:
            ValueError: the rate is not a number from 1 to 1000.
        """
        rate = options.get("rate", USUAL_RATE)
        if not isinstance(rate, int | float) or not 1 <= rate <= 1000:
            raise ValueError(f"rate: expected a number from 1 to 1000 (Hz), got {rate!r}")
        steps: int = round(SECONDS * rate)
        return steps

    def initial_states(self, noise: Array) -> Array:  # noqa: D102
        return START_SD * noise

    def transition(self, states: Array, actions: Array, noise: Array) -> Array:  # noqa: D102
        count = ceil(self.step_seconds / SUBSTEP - 1e-9)  # the margin is for rounding of the quotient
        h, force = self.step_seconds / count, actions[:, 0]
        columns = np.ascontiguousarray(states.T)
        for _ in range(count):
            first = self.derivative(columns, force)
            second = self.derivative(columns + h / 2 * first, force)
            third = self.derivative(columns + h / 2 * second, force)
            fourth = self.derivative(columns + h * third, force)
            columns = columns + h / 6 * (first + 2 * (second + third) + fourth)
        return columns.T

    def derivative(self, columns: Array, force: Array) -> Array:
        """Return the time derivative of states of shape (4, num_envs) under forces of shape (num_envs,)."""
        _, v, angle, w = columns
        m, l, total = self.mass, self.length, self.cart_mass + self.mass  # noqa: E741  # the equations' name
        sine, cosine = np.sin(angle), np.cos(angle)
        push, d, spin = force - self.friction * v, 4 * total - 3 * m * cosine**2, m * l * w**2 * sine
        acceleration = (2 * spin + 3 * m * self.gravity * sine * cosine + 4 * push) / d
        turning = -(3 * spin * cosine + 6 * total * self.gravity * sine + 6 * push * cosine) / (l * d)
        return np.stack([v, acceleration, w, turning])

    def reward(self, states: Array, actions: Array) -> Array:  # noqa: D102
        scale = USUAL_WIDTH / self.reward_width
        exponent = (scale * (np.pi - np.abs(wrapped(states[:, 2]))) / USUAL_WIDTH) ** 2 + (scale * states[:, 0]) ** 2
        return USUAL_RATE / self.rate * np.exp(-exponent)

    def terminations(self, states: Array) -> Flags:  # noqa: D102
        return super().terminations(states) if self.rail is None else np.abs(states[:, 0]) > self.rail

    def observe(self, states: Array, noise: Array) -> Array:  # noqa: D102
        x, v, angle, w = np.ascontiguousarray(states.T)
        return np.stack([x, v, np.cos(angle), np.sin(angle), w], axis=1)

    def bodies(self) -> list[Body]:
        """Return the rail, the floor, the cart, the pole and its tip, the target, and the force as a row of beads."""
        length = 2 * (self.rail or DRAWN_HALF)
        return [
            Body("box", (length, 0.05, 0.03), PALE),
            Body("box", (length, 0.6, 0.01), PALE),
            Body("box", CART_SIZE, DARK),
            Body("cylinder", (0.03, 0.03, REACH), BLUE),
            Body("ball", (0.08, 0.08, 0.08), BLUE),
            Body("ball", (0.1, 0.1, 0.1), GREEN),
            *beads(BEADS, 0.03, 0.07),
        ]

    def poses(self, observations: Array, actions: Array) -> tuple[Array, Array]:
        """Return the poses of the bodies; the row of a force of 10 N is half a metre long."""
        x, angle = observations[:, :1], np.arctan2(observations[:, 3:4], observations[:, 2:3])
        across, up, zero = REACH * np.sin(angle), -REACH * np.cos(angle), 0 * x
        row = x + METRES_PER_NEWTON * np.linspace(0.0, 1.0, BEADS) * actions[:, :1]
        along = np.concatenate([zero, zero, x, x + across / 2, x + across, zero, row], axis=1)
        heights = np.concatenate([zero, zero + FLOOR, zero, up / 2, up, zero + REACH, 0 * row - 0.17], axis=1)
        depth = np.array([0.0, 0.0, 0.0, -0.12, -0.12, -0.12, *[-0.12] * BEADS])  # in front of the cart
        turns = np.zeros_like(along)
        turns[:, 3:4] = np.pi - angle  # the z axis points from the joint to the tip
        return in_plane(along, depth, heights, turns)
