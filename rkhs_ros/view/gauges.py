"""A task that does not say how it looks, as beads on rods."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from rkhs_ros.pictures.style import COLOURS
from rkhs_ros.rkhs.kernels import Array

PALE = "#CCCCCC"
MOST_OBSERVED, MOST_DONE = 12, 6  # numbers that are shown
STEP_S = 0.1  # that a step takes on the page


class Rigid(NamedTuple):
    """A rod or a bead."""

    shape: str
    size: tuple[float, float, float]
    colour: str


class Moved(NamedTuple):
    """Where the rods and beads are at each step."""

    times: Array
    places: Array
    turns: Array


class Gauges:
    """A task that says nothing of how it looks, as a bead on a rod for each number, between its extremes.

    Args:
        observations: how many numbers are observed.
        actions: how many numbers are done.
    """

    def __init__(self, observations: int, actions: int) -> None:
        self._shown = min(observations, MOST_OBSERVED), min(actions, MOST_DONE)

    def eye(self) -> tuple[float, float, float]:
        """Return the direction from which they are looked at."""
        return (0.0, -1.0, 0.1)

    def room(self) -> tuple[tuple[float, float, float], tuple[float, float, float]]:
        """Return the corners of the box in which they are."""
        return (-1.1, 0.0, -1.1), (1.1, 0.0, 1.1)

    def bodies(self) -> Sequence[Rigid]:
        """Return the rods, and the beads: blue for what is observed, orange for what is done."""
        blue, orange, *_ = COLOURS
        colours = [blue] * self._shown[0] + [orange] * self._shown[1]
        return [Rigid("cylinder", (0.03, 0.03, 2.0), PALE) for _ in colours] + [
            Rigid("ball", (0.16, 0.16, 0.16), colour) for colour in colours
        ]

    def motion(self, observations: Array, actions: Array) -> Moved:
        """Return how the beads move in an episode."""
        values = np.concatenate([observations[:, : self._shown[0]], actions[:, : self._shown[1]]], axis=1)
        low, high = values.min(axis=0), values.max(axis=0)
        heights = np.where(high > low, 2 * (values - low) / np.maximum(high - low, 1e-300) - 1, 0.0)
        across = np.broadcast_to(np.linspace(-1, 1, values.shape[1]), values.shape)
        rods, beads = (np.stack([across, 0 * across, z], axis=2) for z in (0 * heights, heights))
        places = np.concatenate([rods, beads], axis=1)
        turns = np.broadcast_to([1.0, 0.0, 0.0, 0.0], (*places.shape[:2], 4))
        return Moved(STEP_S * np.arange(len(values), dtype=np.float64), places, turns)
