"""A task that does not say how it looks: what is observed and done in an episode, as bars over its steps."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from rkhs_ros.pictures.style import COLOURS, folded, pixels
from rkhs_ros.policies.input_names import Names
from rkhs_ros.rkhs.kernels import Array
from rkhs_ros.view.bodies import NO_TURN, Poses, Primitive

MOST_OBSERVED, MOST_DONE = 8, 4  # numbers that are shown
MOST_BARS = 120  # of a number
STEP_S = 0.1  # that a step takes on the page
SIZE, DPI = (4.7, 4.7), 150  # inches
LEFT, RIGHT, BOTTOM, TOP = 0.34, 0.97, 0.05, 0.97  # of the bars, in parts of the picture
NAME_IN, NAME_SIZE = 1.45, 9  # width of a name, inches, and points
EDGE = 1.1  # of the picture, to each side of its middle
BLUE, ORANGE, *_ = COLOURS
CURSOR = Primitive("box", (0.012, 0.004, 2 * EDGE * (TOP - BOTTOM)), "#00B85C")  # at the step that is shown


class Timeline:
    """A task of which nothing is known but its numbers: bars for each, and a line that moves over them.

    Args:
        names: of what is observed and done.
    """

    def __init__(self, names: Names) -> None:
        self._names = names

    def eye(self) -> tuple[float, float, float]:
        """Return the direction from which it is looked at."""
        return (0.0, -1.0, 0.1)

    def room(self) -> tuple[tuple[float, float, float], tuple[float, float, float]]:
        """Return the corners of the picture."""
        return (-EDGE, 0.0, -EDGE), (EDGE, 0.0, EDGE)

    def bodies(self) -> Sequence[Primitive]:
        """Return the line."""
        return [CURSOR]

    def motion(self, observations: Array, actions: Array) -> Poses:
        """Return how the line moves in an episode, before the picture."""
        count = len(observations)
        part = LEFT + (RIGHT - LEFT) * (np.arange(count) + 0.5) / count
        across, middle = EDGE * (2 * part - 1), EDGE * (BOTTOM + TOP - 1)
        places = np.stack([across, np.full(count, -0.02), np.full(count, middle)], axis=1)[:, None]
        turns = np.broadcast_to(NO_TURN, (count, 1, 4))
        return Poses(STEP_S * np.arange(count, dtype=np.float64), places, turns)

    def backdrop(self, observations: Array, actions: Array) -> NDArray[np.uint8]:
        """Return the picture of an episode, RGB of shape (height, width, 3)."""
        return pixels(self.figure(observations, actions))

    def figure(self, observations: Array, actions: Array) -> Figure:
        """Return the figure of an episode: a row of bars for each number, those that are done below."""
        rows = [
            *zip(self._names.observations[:MOST_OBSERVED], observations.T, [BLUE] * MOST_OBSERVED, strict=False),
            *zip(self._names.actions[:MOST_DONE], actions.T, [ORANGE] * MOST_DONE, strict=False),
        ]
        figure = Figure(figsize=SIZE, dpi=DPI, facecolor="white")
        place = {"left": LEFT, "right": RIGHT, "bottom": BOTTOM, "top": TOP, "hspace": 0.25}
        panels = figure.subplots(len(rows), 1, squeeze=False, gridspec_kw=place)[:, 0]
        lines = max(1, 12 // len(rows))
        for axes, (name, values, colour) in zip(panels, rows, strict=True):
            _draw_bars(axes, values, colour)
            words = folded(name, NAME_IN, NAME_SIZE).splitlines()
            text = "\n".join(words[:lines]) + " …" * (len(words) > lines)
            axes.text(-0.03, 0.5, text, transform=axes.transAxes, ha="right", va="center", fontsize=NAME_SIZE)
        return figure


def _draw_bars(axes: Any, values: Array, colour: str) -> None:
    """Draw bars from zero, of the extreme of each of some parts of a long episode."""
    parts = np.array_split(values, min(len(values), MOST_BARS))
    heights = np.array([part[np.argmax(np.abs(part))] for part in parts])
    edges = np.linspace(0.0, len(values), len(parts) + 1)
    axes.stairs(heights, edges, fill=True, color=colour)
    axes.axhline(0.0, color="0.6", linewidth=0.6)
    low, high = min(float(heights.min()), 0.0), max(float(heights.max()), 0.0)
    room = 0.05 * (high - low) or 1.0
    axes.set(xlim=(0, len(values)), ylim=(low - room, high + room), xticks=[], yticks=[])
    axes.spines[:].set_visible(False)
