"""Learning curve of a run in a file, with one line per iteration."""

from __future__ import annotations

import os
import re
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple, get_type_hints

import numpy as np
from numpy.typing import NDArray

from rkhs_ros.base.files import named, read_whole, write_whole
from rkhs_ros.base.validation import truncated
from rkhs_ros.learning.training import Iteration

END = "\r\n"
TORN = re.compile(r"[-+.,_0-9a-z]*\r?")  # an incomplete line, left by a kill or a full disk
PACE_OF = 20  # last iterations, whose mean duration predicts the rest


class Row(NamedTuple):
    """One line of curve.csv."""

    iteration: int
    episodes: int
    steps: int
    evaluation_episodes: int
    exploration_return: float
    exploration_return_sd: float
    evaluation_return: float
    evaluation_return_sd: float
    undiscounted_exploration_return: float
    undiscounted_evaluation_return: float
    centres: int
    step_size: float
    kl: float
    sparsification_error: float
    model_return: float
    model_error: float
    seconds: float

    @classmethod
    def of(cls, iteration: Iteration, seconds: float) -> Row:
        """Return the line of an iteration that finished a number of seconds after the start."""
        metrics = iteration.metrics
        return cls(
            iteration=iteration.number,
            episodes=iteration.episodes_used,
            steps=iteration.steps_used,
            evaluation_episodes=iteration.state.evaluated,
            exploration_return=iteration.exploration_return,
            exploration_return_sd=float(iteration.exploration_returns.std()),
            evaluation_return=iteration.evaluation_return,
            evaluation_return_sd=iteration.evaluation_return_sd,
            undiscounted_exploration_return=iteration.undiscounted_exploration_return,
            undiscounted_evaluation_return=iteration.undiscounted_evaluation_return,
            centres=metrics.centres,
            step_size=float(metrics.step_size),
            kl=float(metrics.kl),
            sparsification_error=float(metrics.sparsification_error),
            model_return=iteration.model_return,
            model_error=iteration.model_error,
            seconds=seconds,
        )


NAN = float("nan")
BEGINNING = Row(0, 0, 0, 0, NAN, NAN, NAN, NAN, NAN, NAN, 0, NAN, NAN, NAN, NAN, NAN, 0.0)  # before the first iteration
ADDED_LATER = ("undiscounted_exploration_return", "undiscounted_evaluation_return")
MISSING: Mapping[str, Any] = {"steps": 0, **dict.fromkeys(ADDED_LATER, NAN)}  # values of columns that older files lack


def columns(rows: Sequence[Row]) -> dict[str, NDArray[Any]]:
    """Return the columns as arrays by name."""
    return {name: np.array([getattr(row, name) for row in rows]) for name in Row._fields}


def seconds_left(rows: Sequence[Row], iterations: int) -> float:
    """Return the predicted remaining time of a run in seconds; nan if there are fewer than two lines.

    Args:
        rows: all lines, or the last ones.
        iterations: total number of iterations.
    """
    if len(rows) < 2:
        return NAN
    newest, oldest = rows[-1], rows[-min(PACE_OF, len(rows))]
    pace = (newest.seconds - oldest.seconds) / (newest.iteration - oldest.iteration)
    return max(pace, 0.0) * (iterations - newest.iteration)


KINDS = get_type_hints(Row)
LAYOUTS = tuple(
    tuple(name for name in Row._fields if name not in without) for without in ((), ADDED_LATER, tuple(MISSING))
)


class Curve:
    """Learning curve of a run so far.

    Owns its file. A file of an older run stays without the columns that were added later, since checkpoints contain a
    digest of the lines; its rows have 0 steps and undiscounted returns of nan.

    Args:
        path: the file, which may not exist yet.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._names: tuple[str, ...] = Row._fields

    def rows(self) -> list[Row]:
        """Return the lines of iterations 1, 2, ..., without an incomplete last line.

        Raises:
            ValueError: a line is damaged or was edited.
            OSError: the file cannot be read.
        """
        text = read_whole(self.path).decode("ascii", errors="replace") if self.path.exists() else ""
        *lines, torn = text.split(END)
        self._names = next((names for names in LAYOUTS if lines[:1] == [",".join(names)]), Row._fields)
        rows = [self._row(number, line) for number, line in enumerate(lines)]
        if not TORN.fullmatch(torn):
            raise self._damaged(len(lines), torn)
        return rows[1:]

    def begin(self, rows: Iterable[Row]) -> None:
        """Replace the lines of the file.

        Raises:
            OSError: the file cannot be written.
        """
        write_whole(self.path, "".join(map(_line, [self._names, *map(self._values, rows)])).encode())

    def append(self, row: Row) -> None:
        """Append a line.

        Raises:
            OSError: the file cannot be written; it is unchanged.
        """
        with named(self.path):
            size = self.path.stat().st_size
            try:
                with self.path.open("ab") as file:
                    file.write(_line(self._values(row)).encode())
            except OSError:
                os.truncate(self.path, size)  # a full disk may have taken a part
                raise

    def _row(self, number: int, line: str) -> Row:
        """Return the values of the line with a number; BEGINNING for the header."""
        if number == 0 and line == ",".join(self._names):
            return BEGINNING
        row = _row(self._names, line)
        if row is None or row.iteration != number or number == 0:
            raise self._damaged(number, line)
        return row

    def _values(self, row: Row) -> list[object]:
        """Return the values of a row in the columns of the file."""
        return [getattr(row, name) for name in self._names]

    def _damaged(self, number: int, got: str) -> ValueError:
        header = f"the header, {','.join(self._names)[:20]}..."
        expected = f"the original line of iteration {number}" if number else header
        return ValueError(
            f"{self.path}: line {number + 1} is damaged or was edited; expected {expected}, "
            f"got {truncated(repr(got))}. Restore the file, or train in another folder."
        )


def _line(values: Iterable[object]) -> str:
    return ",".join(map(str, values)) + END


def _row(names: Sequence[str], line: str) -> Row | None:
    """Return the values of a line by the names of its columns; None if `_line` would write these values differently."""
    try:
        values = {name: KINDS[name](word) for name, word in zip(names, line.split(","), strict=True)}
    except ValueError:
        return None
    return Row(**{**MISSING, **values}) if _line(values.values()) == line + END else None
