"""Plot the learning curve on the page: returns against episodes, with the task's reference returns."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import cycle
from typing import Any

import numpy as np
from viser import GuiApi

from rkhs_ros.rkhs.kernels import Array
from rkhs_ros.runs.curve import Row

MAX_POINTS = 1000
PADDING_PX = 8  # above and beside the plot, for the outermost tick labels
TICKS_PX, LABEL_PX = 26, 22  # heights of the tick labels and of the axis label
WHOLE = tuple(digit * 10**power for power in range(7) for digit in (1, 2, 5))  # tick distances
NAMES = {"exploration_return": "exploration", "evaluation_return": "evaluation", "model_return": "model rollouts"}
COLOURS = {"exploration_return": "#E69F00", "evaluation_return": "#0072B2", "model_return": "#CC79A7"}
GREYS = ("#333333", "#777777", "#aaaaaa")  # of reference returns


class CurvePlot:
    """The plot of a learning curve.

    Owns the plot and the number of rows drawn last.

    Args:
        gui: GUI of the page.
        place: GUI folder that contains the plot.
        known: reference returns of the task, by name.
        height_px: height of the plot.
    """

    def __init__(self, gui: GuiApi, place: Any, known: Mapping[str, float], height_px: int) -> None:
        self._gui = gui
        self._place = place
        self._known = known
        self._height_px = height_px
        self._plot: Any = None
        self._drawn = 0

    def draw(self, rows: Sequence[Row]) -> None:
        """Draw the learning curve if it changed since the last call."""
        if len(rows) == self._drawn or not rows:
            return
        self._drawn = len(rows)
        data = plotted(rows, self._known)
        greys = cycle(GREYS)
        series = [{"label": "episodes"}]
        series += [_look(name, COLOURS.get(name) or next(greys)) for name in list(data)[1:]]
        if self._plot is None or len(self._plot.series) != len(series):
            self._renew(tuple(data.values()), tuple(series))
        else:
            self._plot.data = tuple(data.values())

    def _renew(self, data: tuple[Array, ...], series: tuple[Any, ...]) -> None:
        if self._plot is not None:
            self._plot.remove()
        across = {"label": "episodes", "size": TICKS_PX, "labelSize": LABEL_PX, "labelGap": 0, "incrs": WHOLE}
        axes: Any = (across, {"label": "return"})
        more: Any = {"scales": {"x": {"time": False}}, "padding": (PADDING_PX, PADDING_PX, 0, 0)}
        more["legend"] = {"live": False}  # a live legend shows "--" until the user points at the plot
        with self._place:
            self._plot = self._gui.add_uplot(data, series, axes=axes, height=self._height_px, **more)


def plotted(rows: Sequence[Row], known: Mapping[str, float]) -> dict[str, Array]:
    """Return the columns to plot, episodes first; long curves are thinned, keeping the last row.

    Returns that are not measured in every iteration are interpolated linearly. A return that is never measured is
    left out.
    """
    places = np.unique(np.linspace(0, len(rows) - 1, MAX_POINTS).round().astype(int))
    some = [rows[place] for place in places]
    data = {"episodes": np.array([row.episodes for row in some], dtype=float)}
    for name in NAMES:
        values = np.array([getattr(row, name) for row in some], dtype=float)
        measured = np.isfinite(values)
        if measured.any():
            x = data["episodes"]
            data[name] = np.interp(x, x[measured], values[measured], left=np.nan)
    return data | {name: np.full(len(some), value) for name, value in known.items()}


def _look(name: str, colour: str) -> dict[str, Any]:
    if name in NAMES:
        width = 2.5 if name == "evaluation_return" else 1.5
        return {"label": NAMES[name], "stroke": colour, "width": width, "points": {"show": False}}
    return {"label": name, "stroke": colour, "width": 1, "dash": [6, 4], "points": {"show": False}}
