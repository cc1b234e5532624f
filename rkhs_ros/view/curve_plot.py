"""Plot the learning curve on the page: returns against episodes, with the task's reference returns."""

from collections.abc import Mapping, Sequence
from itertools import cycle
from typing import Any

import numpy as np
from viser import GuiApi

from rkhs_ros.learning.iteration import Row
from rkhs_ros.rkhs.kernels import Array

MAX_POINTS = 1000
PADDING_PX = 8  # above and beside the plot, for the outermost tick labels
TICKS_PX, LABEL_PX = 26, 22  # heights of the tick labels and of the axis label
WHOLE = tuple(digit * 10**power for power in range(7) for digit in (1, 2, 5))  # tick distances
NAMES = {"exploration_return": "exploration", "evaluation_return": "evaluation", "model_return": "model rollouts"}
COLOURS = {"exploration_return": "#E69F00", "evaluation_return": "#0072B2", "model_return": "#CC79A7"}
OTHERS = ("#009E73", "#D55E00", "#56B4E9", "#F0E442")  # of other runs
GREYS = ("#333333", "#777777", "#aaaaaa")  # of reference returns


class CurvePlot:
    """The plot of a learning curve.

    Owns the plot and the numbers of rows drawn last.

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
        self._drawn: tuple[int, ...] = ()

    def draw(self, rows: Sequence[Row], others: Mapping[str, Sequence[Row]]) -> None:
        """Draw the learning curve, and the evaluation returns of other runs by name, if a curve changed."""
        lengths = tuple(len(each) for each in (rows, *others.values()))
        if lengths == self._drawn or not rows:
            return
        self._drawn = lengths
        data = plotted(rows, self._known, others)
        colours = dict(zip(others, cycle(OTHERS), strict=False)) | dict(zip(self._known, cycle(GREYS), strict=False))
        series = [{"label": "episodes"}]
        series += [_look(name, (COLOURS | colours)[name], is_run=name in others) for name in list(data)[1:]]
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


def plotted(rows: Sequence[Row], known: Mapping[str, float], others: Mapping[str, Sequence[Row]]) -> dict[str, Array]:
    """Return the columns to plot, episodes first; long curves are thinned, keeping the last row.

    Returns that are not measured in every iteration are interpolated linearly. A return that is never measured is
    left out.

    Args:
        rows: lines of the learning curve, at least one.
        known: reference returns by name.
        others: lines of other runs by name, of which the evaluation returns are plotted.
    """
    curves = [_thinned(each) for each in (rows, *others.values())]
    x = np.unique([float(row.episodes) for curve in curves for row in curve])
    wanted = [(name, name, curves[0]) for name in NAMES]
    wanted += [(name, "evaluation_return", curve) for name, curve in zip(others, curves[1:], strict=True)]
    data = {"episodes": x}
    for name, column, curve in wanted:
        values = np.array([(row.episodes, getattr(row, column)) for row in curve], dtype=float).reshape(-1, 2)
        measured = values[np.isfinite(values[:, 1])]
        if len(measured):
            inside = x <= values[-1, 0]
            data[name] = np.where(inside, np.interp(x, measured[:, 0], measured[:, 1], left=np.nan), np.nan)
    return data | {name: np.full(len(x), value) for name, value in known.items()}


def _thinned(rows: Sequence[Row]) -> list[Row]:
    """Return evenly spaced rows with the first and the last one."""
    if not rows:
        return []
    return [rows[place] for place in np.unique(np.linspace(0, len(rows) - 1, MAX_POINTS).round().astype(int))]


def _look(name: str, colour: str, *, is_run: bool) -> dict[str, Any]:
    if is_run:
        return {"label": name, "stroke": colour, "width": 1.5, "points": {"show": False}}
    if name in NAMES:
        width = 2.5 if name == "evaluation_return" else 1.5
        return {"label": NAMES[name], "stroke": colour, "width": width, "points": {"show": False}}
    return {"label": name, "stroke": colour, "width": 1, "dash": [6, 4], "points": {"show": False}}
