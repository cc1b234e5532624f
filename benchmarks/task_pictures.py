"""Draw the curves of the table of tasks: a picture of each task, and one of all."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullFormatter, SymmetricalLogLocator

from rkhs_ros.rkhs.kernels import Array
from task_learners import LEARNERS
from task_table import Cell, Cells, profile, with_minus
from trial import TASKS, Point

STEPS = (1.0, 2.0, 5.0)  # of logarithmic axes
LINES = "-", (0, (7, 1)), "-.", (0, (4, 1, 1, 1, 1, 1)), ":", "--", (0, (1, 3))  # told apart without colours, too
STYLES: dict[str, dict[str, Any]] = {
    learner: {"color": f"C{number}", "linestyle": LINES[number], "linewidth": 1.5 if number else 2.0}
    for number, learner in enumerate(LEARNERS)
}


def picture(task: str, cells: Mapping[str, Cell]) -> Figure:
    """Return the returns of the learners over episodes and over seconds of experience: medians and quartiles."""
    figure = Figure((9.0, 3.0), layout="constrained")
    units = {"episodes": 1.0} | (
        {} if np.isnan(TASKS[task].rate) else {"seconds of experience": 1.0 / TASKS[task].rate}
    )
    panels = figure.subplots(1, len(units), sharey=True, squeeze=False)[0]
    for learner, cell in cells.items():
        for panel, (name, unit) in zip(panels, units.items(), strict=True):
            counted = "episodes" if name == "episodes" else "steps"
            first = max(getattr(curve[0], counted) for curve in cell.curves)
            at = np.unique([getattr(point, counted) for curve in cell.curves for point in curve])
            at = at[at >= first]  # before, the median would be of some runs alone
            steady = [_held(cell, curve, counted, at) for curve in cell.curves]
            low, middle, high = np.quantile(steady, (0.25, 0.5, 0.75), axis=0)
            (line,) = panel.plot(at * unit, middle, label=f"{learner} ({len(steady)})", **STYLES[learner])
            panel.fill_between(at * unit, low, high, alpha=0.2, color=line.get_color(), linewidth=0)
    for panel, name in zip(panels, units, strict=True):
        _count_along(panel, name)
        least = TASKS[task].thresholds[0]
        panel.axhline(least, color="0.5", linewidth=0.8, linestyle=":")
        if least < 0.0:  # early returns are far below the threshold
            panel.set_yscale("symlog", linthresh=-least)
            panel.set_ylim(top=0.0)
            panel.yaxis.set_major_locator(SymmetricalLogLocator(base=10.0, linthresh=-least, subs=STEPS))
            panel.yaxis.set_major_formatter(lambda value, _: with_minus(f"{value:g}"))
        panel.annotate(
            with_minus(f"{least:g}"), (1.01, least), xycoords=("axes fraction", "data"), va="center", fontsize=8
        )
    panels[0].set_ylabel("return" + " (discounted)" * TASKS[task].discounted + ", logarithmic" * (least < 0.0))
    names = panels[0].get_legend_handles_labels()
    figure.legend(*names, loc="outside upper center", ncols=len(cells), fontsize="small", frameon=False, title=task)
    return figure


def _count_along(panel: Axes, name: str) -> None:
    """Give a panel a logarithmic axis of counts, with plain numbers."""
    panel.set(xscale="log", xlabel=name)
    low, high = panel.get_xlim()
    panel.xaxis.set_major_locator(LogLocator(subs=STEPS if high < 500.0 * low else (1.0,)))
    panel.xaxis.set_major_formatter("{x:,g}")
    panel.xaxis.set_minor_formatter(NullFormatter())


def _held(cell: Cell, curve: Sequence[Point], counted: str, at: Array) -> Array:
    """Return the return of the last point before each count, none of which is before the first point."""
    counts = np.array([getattr(point, counted) for point in curve])
    last = np.searchsorted(counts, at, side="right") - 1
    return cell.returns(curve)[last]


def picture_of_all(cells: Cells) -> Figure:
    """Return the share of runs that reached the first threshold, over the tasks that all learners of most tasks ran."""
    counts = {each: sum(each in its for its in cells.values()) for each in LEARNERS if not LEARNERS[each].holds_actions}
    learners = [each for each, count in counts.items() if 2 * count >= len(cells)]
    common = [its for its in cells.values() if set(learners) <= set(its)]
    figure = Figure((9.0, 2.8), layout="constrained")
    for panel, measure in zip(figure.subplots(1, 2, sharey=True), ("episodes", "steps"), strict=True):
        for learner in learners:
            counts = [-its[learner].scores(measure) for its in common]
            ends = [getattr(curve[-1], measure) for its in common for curve in its[learner].curves]
            at = np.unique([count for each in (*counts, ends) for count in each if np.isfinite(count)])
            share = profile(counts, at)
            (line,) = panel.step(at, share.value, where="post", label=learner, **STYLES[learner])
            panel.fill_between(at, share.low, share.high, step="post", alpha=0.2, color=line.get_color(), linewidth=0)
        _count_along(panel, measure)
        panel.set(xlim=(1.0, None), ylim=(-0.03, 1.03))
    panel.legend(fontsize="small", frameon=False)
    figure.supylabel(f"share of runs, {len(common)} tasks", fontsize="medium")
    return figure


def draw(cells: Cells) -> dict[str, Figure]:
    """Return the pictures of the tasks that ours was run on, and that of all, by name."""
    return {task: picture(task, its) for task, its in cells.items() if "ours" in its} | {"all": picture_of_all(cells)}
