"""The toy task of Lever and Stafford (2015), section 4.1 of the paper."""

from __future__ import annotations

from typing import ClassVar

import numpy as np
from gymnasium.spaces import Box

from sim_nodes.envs.vector_task import Array, VectorTask, clip


class Toy(VectorTask):
    r"""Move along a line to the point 3.

    .. math:: s_{t+1} = s_t + a_t + \epsilon, \qquad r(s, a) = \exp(-|s - 3|), \qquad s_0 = 0

    State in [-4, 4], action in [-1, 1]. The paper's "small" noise is taken as 0.11, at which dynamic programming
    gives its optimum of 14.5.
    """

    single_observation_space = Box(-4.0, 4.0, (1,), np.float64)
    single_action_space = Box(-1.0, 1.0, (1,), np.float64)
    reference_returns: ClassVar[dict[str, float]] = {"optimum (dynamic programming)": 14.5}
    noise_dim = 1
    noise_sd = 0.11

    def initial_states(self, rows: int) -> Array:  # noqa: D102
        return np.zeros((rows, 1))

    def transition(self, states: Array, actions: Array, noise: Array) -> Array:  # noqa: D102
        return clip(states + actions + self.noise_sd * noise, -4.0, 4.0)

    def reward(self, states: Array, actions: Array) -> Array:  # noqa: D102
        return np.exp(-np.abs(states[:, 0] - 3.0))
