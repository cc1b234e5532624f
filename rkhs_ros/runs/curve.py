"""Learning curve of a run in a file, with one line per iteration, and in TensorBoard event files.

The columns are the fields of `rkhs_ros.learning.iteration.Row`.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from math import isfinite
from pathlib import Path
from typing import Any, get_type_hints

import numpy as np
from numpy.typing import NDArray

from rkhs_ros.base.files import named, write_whole
from rkhs_ros.base.validation import require, require_extra, truncated
from rkhs_ros.learning.iteration import Row, standard_error

END = "\r\n"
PACE_OF = 20  # last iterations, whose mean duration predicts the rest
EVENTS = "tensorboard"  # folder in that of the run
NAN = float("nan")


def columns(rows: Sequence[Row]) -> dict[str, NDArray[Any]]:
    """Return the columns as arrays by name."""
    return {name: np.array([getattr(row, name) for row in rows]) for name in Row._fields}


def evaluation_errors(curve: Mapping[str, NDArray[Any]]) -> NDArray[Any]:
    """Return the standard error of each evaluation return of a whole curve, 0 without an evaluation.

    Args:
        curve: the columns of all lines.
    """
    counts = np.diff(curve["evaluation_episodes"], prepend=0)
    return np.array(list(map(standard_error, curve["evaluation_return_sd"], counts)))


def seconds_left(rows: Sequence[Row], iterations: int) -> float:
    """Return the predicted remaining time of a run in seconds; nan if there are fewer than two lines.

    The rows are all or the last ones; ``iterations`` is the total number.
    """
    if len(rows) < 2:
        return NAN
    newest, oldest = rows[-1], rows[-min(PACE_OF, len(rows))]
    pace = (newest.seconds - oldest.seconds) / (newest.iteration - oldest.iteration)
    return max(pace, 0.0) * (iterations - newest.iteration)


KINDS = get_type_hints(Row)
# The row before the first iteration.
BEGINNING = Row._make(0 if kind is int else NAN for kind in KINDS.values())._replace(seconds=0.0)
HEADER = ",".join(Row._fields)


class Curve:
    """Learning curve of a run in a file, which may not exist yet; a resumed run derives it from the recording."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def rows(self) -> list[Row]:
        """Return the complete lines; none without a file.

        Raises:
            ValueError: the header or a line differs from what a run writes.
        """
        if not self.path.exists():
            return []
        *lines, _ = self.path.read_bytes().decode("ascii", errors="replace").split(END)
        require(
            lines[:1] in ([], [HEADER]), f"{self.path}", f"the header {HEADER[:20]}...", truncated("".join(lines[:1]))
        )
        return [self._row(number, line) for number, line in enumerate(lines[1:], 2)]

    def begin(self, rows: Iterable[Row]) -> None:
        """Replace the lines of the file."""
        write_whole(self.path, "".join([HEADER + END, *map(_line, rows)]).encode(), sync=False)

    def append(self, row: Row) -> None:
        """Append a line."""
        with named(self.path), self.path.open("ab") as file:
            file.write(_line(row).encode())

    def _row(self, number: int, line: str) -> Row:
        try:
            row = Row(*(kind(word) for kind, word in zip(KINDS.values(), line.split(","), strict=True)))
            require(row.iteration == number - 1, "iteration", f"{number - 1}", row.iteration)
            return row
        except ValueError as error:
            expected = f"{len(KINDS)} numbers of iteration {number - 1} in line {number}"
            raise ValueError(f"{self.path}: expected {expected}, got {truncated(repr(line))}") from error


def _line(row: Row) -> str:
    return ",".join(map(str, row)) + END


def has_events(folder: Path | None, requested: bool) -> bool:
    """Return whether a run writes TensorBoard events: if this is requested, or if its folder contains events."""
    chosen = requested or (folder is not None and (folder / EVENTS).is_dir())
    if chosen:
        require_extra("tensorboardX", "tensorboard", "--tensorboard")
    return chosen


@contextmanager
def logged(folder: Path, rows: Iterable[Row]) -> Iterator[Callable[[Row], None]]:
    """Write the rows of a run as TensorBoard events; yield a function that adds a row."""
    from tensorboardX import SummaryWriter  # an optional dependency

    def add(row: Row) -> None:
        for name, value in row._asdict().items():
            if name != "iteration" and isfinite(value):
                writer.add_scalar(name, value, row.iteration)
        writer.flush()

    with SummaryWriter(str(folder / EVENTS), purge_step=1) as writer:  # TensorBoard discards earlier events
        for row in rows:
            add(row)
        yield add
