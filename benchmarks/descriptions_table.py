"""Summarise how the episodes to a threshold depend on the description of a task, as CSV and as Markdown."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from dataclasses import dataclass
from io import StringIO

import numpy as np

HEAD = ("task", "description", "runs", "reached", "episodes", "ratio", "last return")
CAPTION = (
    "Runs that reach the threshold, and median of the episodes until the evaluation return first does, infinite for a\n"
    "run that does not. Ratio of this median to the least one of the task. Median of the last evaluation returns, in\n"
    "the units of the task as written.\n"
)


@dataclass(frozen=True)
class Row:
    """The runs with one description of a task.

    Attributes:
        task: name of the task.
        description: name of the description.
        threshold: threshold of the undiscounted return, in the units of the task as written.
        curves: for each run the episodes and the evaluation return, in these units, after each update.
    """

    task: str
    description: str
    threshold: float
    curves: Sequence[Sequence[tuple[int, float]]]

    @property
    def reached(self) -> list[float]:
        """Episodes of each run until its return first reaches the threshold; infinite if it never does."""
        return [
            next((float(episodes) for episodes, value in curve if value >= self.threshold), np.inf)
            for curve in self.curves
        ]

    @property
    def episodes(self) -> float:
        """Median of the episodes to the threshold."""
        numbers = sorted(self.reached)
        middle = numbers[(len(numbers) - 1) // 2 : len(numbers) // 2 + 1]  # numpy's median of infinite numbers is nan
        return sum(middle) / len(middle)

    @property
    def last_return(self) -> float:
        """Median of the last evaluation returns."""
        return float(np.median([curve[-1][1] for curve in self.curves]))

    def cells(self, best: float) -> tuple[str, ...]:
        """Return the cells of the row.

        Args:
            best: the least median of the task.
        """
        count = sum(np.isfinite(self.reached))
        ratio = self.episodes / best if np.isfinite(self.episodes) else np.inf
        numbers = (f"{len(self.curves)}", f"{count}", f"{self.episodes:g}", f"{ratio:.2g}", f"{self.last_return:.4g}")
        return (self.task, self.description, *numbers)


def cells_of(rows: Sequence[Row]) -> list[tuple[str, ...]]:
    """Return the cells of all rows."""
    best = {row.task: min(each.episodes for each in rows if each.task == row.task) for row in rows}
    return [row.cells(best[row.task]) for row in rows]


def as_csv(rows: Sequence[Row]) -> str:
    """Return CSV with a line for each description of each task."""
    text = StringIO(newline="")
    csv.writer(text, lineterminator="\n").writerows([HEAD, *cells_of(rows)])
    return text.getvalue()


def as_markdown(rows: Sequence[Row]) -> str:
    """Return one table per task, with a legend below."""
    tables = []
    cells = cells_of(rows)
    for task, threshold in {row.task: row.threshold for row in rows}.items():
        lines = [HEAD[1:], ("---",) * len(HEAD[1:]), *(each[1:] for each in cells if each[0] == task)]
        body = "\n".join(f"| {' | '.join(line)} |" for line in lines)
        tables.append(f"**{task}** (undiscounted return of {threshold:g})\n\n{body}\n")
    return "\n".join([*tables, CAPTION])
