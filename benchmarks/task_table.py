"""Make the table and the pictures of docs/tasks.md from the curves of benchmarks/tasks.py."""

import csv
from collections.abc import Mapping, Sequence
from io import StringIO
from pathlib import Path
from typing import NamedTuple

import numpy as np
from matplotlib.figure import Figure

from rkhs_ros.rkhs.kernels import Array
from rkhs_ros.studies.aggregates import Estimate, mean_over_runs
from task_learners import LEARNERS
from tasks import CURVES, TASKS, Curves, Task, read_curves
from trial import Point, median_until

PAGE = Path(__file__).parents[1] / "docs" / "tasks.md"
TABLE = PAGE.parent / "results" / "tasks_table.csv"
AFTER = (5, 10, 20, 50, 100)  # episodes
BEGIN, END = "<!-- made by benchmarks/task_table.py -->\n", "<!-- end -->\n"


class Cell(NamedTuple):
    """The curves of a learner on a task."""

    task: Task
    curves: Sequence[Sequence[Point]]

    def returns(self, curve: Sequence[Point]) -> Array:
        """Return the returns of a curve that the thresholds are for."""
        return np.array([p.discounted_return if self.task.discounted else p.undiscounted_return for p in curve])

    def first(self, threshold: float) -> list[int | None]:
        """Return the number of the first point of each curve that reaches a threshold."""
        reached = [np.flatnonzero(self.returns(curve) >= threshold) for curve in self.curves]
        return [int(each[0]) if len(each) else None for each in reached]

    def until(self, threshold: float, measure: str) -> Estimate:
        """Return the median ``episodes`` or ``steps`` until a threshold; infinite where it is not reached."""
        counts = [
            np.inf if at is None else float(getattr(curve[at], measure))
            for at, curve in zip(self.first(threshold), self.curves, strict=True)
        ]
        return median_until(np.array(counts))

    def after(self, episodes: int) -> Array:
        """Return the return of each curve at its last point within a number of episodes; nan if it ends earlier."""
        return np.array([self._after(curve, episodes) for curve in self.curves])

    def _after(self, curve: Sequence[Point], episodes: int) -> float:
        within = [number for number, point in enumerate(curve) if point.episodes <= episodes]
        return float(self.returns(curve)[within[-1]]) if within and curve[-1].episodes >= episodes else np.nan

    def below(self, threshold: float) -> str:
        """Return how many of the points after the first success are below the threshold."""
        later = [
            self.returns(curve)[at + 1 :] < threshold
            for at, curve in zip(self.first(threshold), self.curves, strict=True)
            if at is not None
        ]
        count = sum(map(len, later))
        return f"{sum(each.sum() for each in later) / count:.0%}" if count else "-"


def cells_of(curves: Curves) -> dict[str, dict[str, Cell]]:
    """Return the cells by task and learner, in the order of the tables."""
    found: dict[str, dict[str, Cell]] = {}
    for task in TASKS:
        for learner in LEARNERS:
            its = [curve for key, curve in curves.items() if key[:2] == (task, learner)]
            if its:
                found.setdefault(task, {})[learner] = Cell(TASKS[task], its)
    return found


def line_of(task: str, learner: str, cell: Cell) -> tuple[str, ...]:
    """Return the line of a learner on a task in the table."""
    thresholds, rate = cell.task.thresholds, cell.task.rate
    episodes = [cell.until(threshold, "episodes") for threshold in thresholds]
    steps = [cell.until(threshold, "steps") for threshold in thresholds]
    seconds = [Estimate(*(each / rate for each in estimate)) for estimate in steps]
    cost = np.median([curve[-1].cpu_seconds / curve[-1].episodes for curve in cell.curves])
    return (
        task,
        learner,
        str(len(cell.curves)),
        " / ".join(_minus(f"{threshold:g}") for threshold in thresholds),
        *(" / ".join(map(shown, each)) for each in (episodes, steps, seconds)),
        *(shown(mean_over_runs(cell.after(count))) for count in AFTER),
        cell.below(thresholds[0]),
        f"{cost:.2g}",
    )


HEAD = (
    *("task", "learner", "seeds", "thresholds", "episodes to them", "steps to them", "seconds to them"),
    *(f"return after {count}" for count in AFTER),
    *("later below", "CPU s per episode"),
)


def shown(estimate: Estimate) -> str:
    """Return three digits of an estimate and its interval."""
    if np.isnan(estimate.value):
        return "-"
    numbers = ["never" if np.isinf(each) else _minus(f"{each:.3g}") for each in estimate]
    alone = np.isnan(estimate.low) or numbers == ["never"] * 3
    return numbers[0] if alone else f"{numbers[0]} [{numbers[1]}, {numbers[2]}]"


def _minus(text: str) -> str:
    return text.replace("-", "\u2212") if text.startswith("-") else text


def overview(cells: Mapping[str, Mapping[str, Cell]]) -> str:
    """Return a Markdown table of the median episodes until the first threshold, one line per task."""
    lines = ["| Task | Return | " + " | ".join(f"`{learner}`" for learner in LEARNERS) + " |"]
    lines.append("|---" * (2 + len(LEARNERS)) + "|")
    for task, its in cells.items():
        threshold = TASKS[task].thresholds[0]
        found = [shown(its[each].until(threshold, "episodes")) if each in its else "-" for each in LEARNERS]
        lines.append(f"| `{task}` | {_minus(f'{threshold:g}')} | {' | '.join(found)} |")
    return "\n".join([*lines, ""])


def picture(task: str, cells: Mapping[str, Cell]) -> Figure:
    """Return the returns of the learners over episodes and over seconds of experience: medians and quartiles."""
    figure = Figure((9.0, 2.8), layout="constrained")
    panels = figure.subplots(1, 2, sharey=True)
    for learner, cell in cells.items():
        for panel, unit in zip(panels, (1.0, 1.0 / TASKS[task].rate), strict=True):
            counted = "episodes" if unit == 1.0 else "steps"
            at = np.unique([getattr(point, counted) for curve in cell.curves for point in curve])
            steady = [_held(cell, curve, counted, at) for curve in cell.curves]
            low, middle, high = np.nanquantile(steady, (0.25, 0.5, 0.75), axis=0)
            (line,) = panel.plot(at * unit, middle, label=learner, color=COLOURS[learner])
            panel.fill_between(at * unit, low, high, alpha=0.2, color=line.get_color(), linewidth=0)
    for panel, name in zip(panels, ("episodes", "seconds of experience"), strict=True):
        panel.set(xscale="log", xlabel=name)
        for threshold in TASKS[task].thresholds:
            panel.axhline(threshold, color="0.7", linewidth=0.8, linestyle=":")
    panels[0].set_ylabel("return" + " (discounted)" * TASKS[task].discounted)
    panels[0].legend(fontsize="small", frameon=False)
    return figure


COLOURS = {learner: f"C{number}" for number, learner in enumerate(LEARNERS)}


def _held(cell: Cell, curve: Sequence[Point], counted: str, at: Array) -> Array:
    """Return the return of the last point before each count; nan before the first point and after the last one."""
    counts = np.array([getattr(point, counted) for point in curve])
    last = np.searchsorted(counts, at, side="right") - 1
    values = cell.returns(curve)[np.maximum(last, 0)]
    return np.where((last >= 0) & (at <= counts[-1]), values, np.nan)


def text_of_table(cells: Mapping[str, Mapping[str, Cell]]) -> str:
    """Return the table as CSV, one line per task and learner."""
    text = StringIO(newline="")
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(HEAD)
    writer.writerows(line_of(task, learner, cell) for task, its in cells.items() for learner, cell in its.items())
    return text.getvalue()


def page_with(overview: str) -> str:
    """Return the page with an overview in place of its own."""
    before, rest = PAGE.read_text().split(BEGIN)
    return before + BEGIN + "\n" + overview + "\n" + END + rest.split(END)[1]


if __name__ == "__main__":
    cells = cells_of(read_curves(CURVES))
    TABLE.write_text(text_of_table(cells))
    PAGE.write_text(page_with(overview(cells)))
    for name, its in cells.items():
        picture(name, its).savefig(PAGE.parent / "results" / "tasks" / f"{name}.png", dpi=100)
