"""Show a task without a 3D scene: bars of its observations and actions over the steps of an episode."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from rkhs_ros.pictures.known import Body, BodyTrajectories
from rkhs_ros.pictures.style import COLOURS, folded
from rkhs_ros.policies.inputs import Names
from rkhs_ros.rkhs.kernels import Array
from rkhs_ros.view.bodies import NO_TURN

MOST_OBSERVED, MOST_DONE = 8, 4  # observations and actions shown
MOST_BARS = 120  # in a row
STEP_S = 0.1  # duration of a step on the page
SIZE, DPI = (4.7, 4.7), 150  # inches
LEFT, RIGHT, BOTTOM, TOP = 0.34, 0.88, 0.1, 0.97  # edges of the bars, relative to the picture
NAME_IN, NAME_SIZE = 1.45, 9  # width of a name in inches, and its size in points
SCALE_SIZE = 7  # of the numbers beside the bars, in points
EDGE = 1.1  # distance of each edge of the picture from its middle
BLUE, ORANGE, *_ = COLOURS
CURSOR = Body("box", (0.012, 0.004, 2 * EDGE * (TOP - BOTTOM)), "#00B85C")  # at the current step


class Timeline:
    """A scene for tasks that define none: a bar chart of an episode, with a line at the current step."""

    view_direction = (0.0, -1.0, 0.1)
    bounds = (-EDGE, 0.0, -EDGE), (EDGE, 0.0, EDGE)

    def __init__(self, names: Names) -> None:
        self._names = names

    def bodies(self) -> Sequence[Body]:
        """Return the line."""
        return [CURSOR]

    def motion(self, observations: Array, actions: Array) -> BodyTrajectories:
        """Return the poses of the line, in front of the picture, during an episode."""
        count = len(observations)
        part = LEFT + (RIGHT - LEFT) * (np.arange(count) + 0.5) / count
        across, middle = EDGE * (2 * part - 1), EDGE * (BOTTOM + TOP - 1)
        positions = np.stack([across, np.full(count, -0.02), np.full(count, middle)], axis=1)[:, None]
        orientations = np.broadcast_to(NO_TURN, (count, 1, 4))
        return BodyTrajectories(STEP_S * np.arange(count, dtype=np.float64), positions, orientations)

    def figure(self, observations: Array, actions: Array) -> Figure:
        """Return the figure of an episode: a row of bars for each observation, then for each action."""
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
        panels[-1].xaxis.set_major_locator(MaxNLocator(5, integer=True))
        panels[-1].set_xlabel("step", fontsize=NAME_SIZE)
        return figure


def _draw_bars(axes: Any, values: Array, colour: str) -> None:
    """Draw bars from zero; a long episode is split into parts, whose extremes are drawn."""
    parts = np.array_split(values, min(len(values), MOST_BARS))
    heights = np.array([part[np.argmax(np.abs(part))] for part in parts])
    edges = np.linspace(0.0, len(values), len(parts) + 1)
    axes.stairs(heights, edges, fill=True, color=colour)
    axes.axhline(0.0, color="0.6", linewidth=0.6)
    low, high = min(float(heights.min()), 0.0), max(float(heights.max()), 0.0)
    margin = 0.05 * (high - low) or 1.0
    scale = [each for each in (low, high) if each != 0.0]
    axes.set(xlim=(0, len(values)), ylim=(low - margin, high + margin), xticks=[])
    axes.set_yticks(scale, [f"{each:.3g}" for each in scale])
    axes.tick_params(labelsize=SCALE_SIZE, length=0, right=False, labelleft=False, labelright=True)
    axes.spines[:].set_visible(False)
