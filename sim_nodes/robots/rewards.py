"""Reward functions of the simulated robots, for robot configurations."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from sim_nodes.robots.mark import CENTRE

Array = NDArray[np.float64]
NEAR = 0.1  # m from the mark, at which the arm's reward is exp(-1 / 2)


def upright(before: Array, executed: Array, after: Array) -> float:
    r"""Return :math:`\exp(-\theta^2 / 2)` of the pendulum's angle before a step, the paper's reward."""
    return float(np.exp(-0.5 * before[0] ** 2))


def distance(observations: Array) -> Array:
    """Return the distance of the arm's tool from the mark, in metres.

    Args:
        observations: y and z of the mark, whose x is constant, then x, y and z of the tool, shape (..., 5).
    """
    mark, tool = observations[..., :2], observations[..., 2:]
    off = np.concatenate([tool[..., :1] - CENTRE[0], tool[..., 1:] - mark], axis=-1)
    return np.asarray(np.linalg.norm(off, axis=-1))


def near(before: Array, executed: Array, after: Array) -> Array:
    r"""Return :math:`\exp(-d^2 / 2 s^2)` of the distance d of the arm's tool from the mark after a step.

    The arguments may have leading dimensions, so that model-based training can use it as a known reward.
    """
    return np.asarray(np.exp(-0.5 * (distance(after) / NEAR) ** 2))
