"""The inverted pendulum with a noisy observation of the angle only: section 4.3 of the paper."""

from typing import ClassVar

import numpy as np
from gymnasium.spaces import Box

from sim_nodes.envs.pendulum import Pendulum
from sim_nodes.envs.vector_task import Array


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
