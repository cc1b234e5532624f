"""A mark that moves in front of the arm, on a known slow path with a random start in each episode."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from rkhs_ros.policies.streams import stream

CENTRE = np.array([0.5, 0.0, 0.45])  # m, in the frame of the arm's base
SIZE = np.array([0.0, 0.2, 0.1])  # m, to both sides
FREQUENCIES = np.array([0.0, 1.0, 2.0])  # of each axis: a horizontal figure eight in the vertical plane
PERIOD_S = 12.0


def first_phase(seed: int, episode: int) -> float:
    """Return the mark's start on its path in an episode, in [0, 1)."""
    return float(stream(seed, "arm/mark", episode).random())


def mark_at(time: float, phase: float) -> NDArray[np.float64]:
    """Return the mark's position x, y, z in metres at a time, in seconds since the start of the episode."""
    return np.asarray(CENTRE + SIZE * np.sin(2 * np.pi * FREQUENCIES * (time / PERIOD_S + phase)))
