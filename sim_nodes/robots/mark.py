"""A mark that moves before the arm, on a slow path that is known but for where on it an episode begins."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from rkhs_ros.policies.streams import stream

CENTRE = np.array([0.5, 0.0, 0.45])  # m, in the frame of the arm's base
SIZE = np.array([0.0, 0.2, 0.1])  # m, to both sides
FREQUENCIES = np.array([0.0, 1.0, 2.0])  # of each axis: a lying eight, across and upright
PERIOD_S = 12.0


def first_phase(seed: int, episode: int) -> float:
    """Return where on its path the mark begins in an episode, in [0, 1)."""
    return float(stream(seed, "arm/mark", episode).random())


def mark_at(time: float, phase: float) -> NDArray[np.float64]:
    """Return where the mark is a time, in seconds, after the beginning of an episode: x, y, z in metres."""
    return np.asarray(CENTRE + SIZE * np.sin(2 * np.pi * FREQUENCIES * (time / PERIOD_S + phase)))
