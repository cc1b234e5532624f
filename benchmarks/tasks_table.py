"""Summarise the learning curves of a table of tasks, as CSV and as Markdown."""

from __future__ import annotations

import csv
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from io import StringIO
from typing import NamedTuple

import numpy as np

from rkhs_ros.rkhs.kernels import Array
from rkhs_ros.studies.aggregates import Estimate, mean_over_runs, median_over_runs
from trial import Point

AFTER = (10, 30, 100)  # episodes
NEVER = 1e15  # episodes or steps, instead of infinity, so that means and differences are defined
CAPTION = (
    "Real episodes and steps until the evaluation return, the mean of 10 episodes after an update, first reaches a\n"
    "threshold: median over the seeds, infinite where it is not reached. Mean return after so many episodes. Median\n"
    "CPU seconds of a run, without evaluations. In brackets 95 % intervals over the seeds by bootstrap."
)


@dataclass(frozen=True)
class Cell:
    """The curves of one learner on one task.

    Attributes:
        task: name of the task.
        learner: name of the learner.
        thresholds: thresholds of the return.
        discounted: whether they are for the discounted return.
        curves: one curve per seed.
    """

    task: str
    learner: str
    thresholds: tuple[float, ...]
    discounted: bool
    curves: Sequence[Sequence[Point]]

    def quantities(self) -> Iterator[Quantity]:
        """Yield the numbers that summarise the curves."""
        for threshold in self.thresholds:
            reached = np.array([self._reached(curve, threshold) for curve in self.curves])
            for name, values in zip(("episodes", "steps"), reached.T, strict=True):
                yield Quantity(f"{name} to", threshold, median_until(values))
        for episodes in AFTER:
            yield Quantity("return after", episodes, self._mean_return_after(episodes))
        yield Quantity("CPU seconds", None, median_until(np.array([curve[-1].cpu_seconds for curve in self.curves])))

    def _return(self, point: Point) -> float:
        return point.discounted_return if self.discounted else point.undiscounted_return

    def _reached(self, curve: Sequence[Point], threshold: float) -> tuple[float, float]:
        """Return episodes and steps at the first point with at least this return."""
        points = ((point.episodes, point.steps) for point in curve if self._return(point) >= threshold)
        return next(points, (np.inf, np.inf))

    def _mean_return_after(self, episodes: int) -> Estimate:
        """Return the mean over the runs at their last point within a number of episodes; nan if a run has none."""
        within = [[p for p in curve if p.episodes <= episodes] for curve in self.curves]
        if not all(within) or any(curve[-1].episodes < episodes for curve in self.curves):
            return Estimate(np.nan, np.nan, np.nan)
        return mean_over_runs(np.array([self._return(points[-1]) for points in within]))


class Quantity(NamedTuple):
    """One number of a cell: its name, its threshold or number of episodes, and its estimate."""

    name: str
    at: float | None
    estimate: Estimate

    @property
    def title(self) -> str:
        """Name in the header of a table."""
        return self.name if self.at is None else f"{self.name} {self.at:g}"


def median_until(values: Array) -> Estimate:
    """Return the median over the runs of counts, some of which may be infinite."""
    estimate = median_over_runs(np.minimum(values, NEVER))
    return Estimate(*(np.inf if number > NEVER / 1e5 else float(number) for number in estimate))


def as_csv(cells: Sequence[Cell]) -> str:
    """Return CSV with one line per number; unknown values are empty."""
    text = StringIO(newline="")
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(("task", "learner", "runs", "quantity", "at", "value", "low", "high"))
    for cell in cells:
        for name, at, estimate in cell.quantities():
            numbers = ("" if np.isnan(number) else number for number in estimate)
            writer.writerow((cell.task, cell.learner, len(cell.curves), name, "" if at is None else at, *numbers))
    return text.getvalue()


def as_markdown(cells: Sequence[Cell]) -> str:
    """Return one table per task, with a legend below."""
    tables = [
        _table(task, [cell for cell in cells if cell.task == task]) for task in dict.fromkeys(c.task for c in cells)
    ]
    return "\n".join([*tables, CAPTION, ""])


def _table(task: str, cells: Sequence[Cell]) -> str:
    quantities = [list(cell.quantities()) for cell in cells]
    rows = [["learner", "runs", *(quantity.title for quantity in quantities[0])]]
    rows += [
        [cell.learner, str(len(cell.curves)), *(_shown(quantity.estimate) for quantity in each)]
        for cell, each in zip(cells, quantities, strict=True)
    ]
    head, *body = (f"| {' | '.join(row)} |" for row in rows)
    kind = "discounted" if cells[0].discounted else "undiscounted"
    return "\n".join([f"**{task}** ({kind} return)", "", head, "|---" * len(rows[0]) + "|", *body, ""])


def _shown(estimate: Estimate) -> str:
    if np.isinf(estimate.value):
        return "not reached"
    return "-" if np.isnan(estimate.value) else str(estimate)
