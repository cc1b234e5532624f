"""Learning curve of a run as TensorBoard event files, in a folder of the run folder.

A run that resumes writes the events anew from curve.csv, so that they contain each finished iteration exactly once,
whatever interrupted the run.
"""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from math import isfinite
from pathlib import Path
from typing import Any

from rkhs_ros.base.endings import error_message
from rkhs_ros.base.files import named
from rkhs_ros.base.validation import require_extra
from rkhs_ros.learning.iteration import Row

FOLDER = "tensorboard"


def has_events(folder: Path | None, requested: bool) -> bool:
    """Return whether a run writes events: if this is requested, or if its folder contains events.

    Raises:
        ValueError: tensorboardX is not installed.
    """
    chosen = requested or (folder is not None and (folder / FOLDER).is_dir())
    if chosen:
        require_extra("tensorboardX", "tensorboard", "--tensorboard")
    return chosen


@contextmanager
def logged(folder: Path, rows: Sequence[Row]) -> Iterator[Callable[[Row], None]]:
    """Write the events of a run until the context exits; yield a function that adds a row.

    If they cannot be written, print a warning and write no more, because the run matters more than its events.

    Args:
        folder: folder of the run.
        rows: rows of the iterations so far.
    """
    files: list[EventFile] = []  # one, or none after a failure

    def add(row: Row) -> None:
        for file in files.copy():
            with _emptied_by_errors(files):
                file.add(row)

    with _emptied_by_errors(files):
        files.append(EventFile(folder / FOLDER, rows))
    try:
        yield add
    finally:
        for file in files.copy():
            with _emptied_by_errors(files):
                file.close()


@contextmanager
def _emptied_by_errors(files: list[EventFile]) -> Iterator[None]:
    """Print a warning and clear the list if writing to its file fails."""
    try:
        yield
    except Exception as error:
        files.clear()
        print(f"warning: --tensorboard: {error_message(error)}. The run continues without it", file=sys.stderr)


class EventFile:
    """An event file with one event for each row. Its times leave out the pauses before a resume."""

    def __init__(self, folder: Path, rows: Sequence[Row]) -> None:
        from tensorboardX import RecordWriter  # SummaryWriter writes in a thread, which hides errors of the disk
        from tensorboardX.proto.event_pb2 import Event, SessionLog

        folder.mkdir(exist_ok=True)
        earlier = list(folder.glob("events.out.tfevents.*"))
        self._began = time.time() - (rows[-1].seconds if rows else 0.0)
        self._file = folder / f"events.out.tfevents.{time.time_ns()}"  # TensorBoard reads files in order of their names
        self._writer = RecordWriter(str(self._file))
        version = Event(wall_time=self._began, file_version="brain.Event:2")
        start = Event(wall_time=self._began, session_log=SessionLog(status=SessionLog.START))  # discards earlier events
        self._write(version, start, *map(self._event, rows))
        for file in earlier:
            os.truncate(file, 0)  # not removed, since an open TensorBoard would wait for it and read no other file

    def add(self, row: Row) -> None:
        """Write a row."""
        self._write(self._event(row))

    def close(self) -> None:
        """Close the file."""
        self._writer.close()

    def _event(self, row: Row) -> Any:
        """Return the event with the finite values of a row."""
        from tensorboardX.proto.event_pb2 import Event
        from tensorboardX.proto.summary_pb2 import Summary

        columns = {name: value for name, value in row._asdict().items() if name != "iteration" and isfinite(value)}
        values = [Summary.Value(tag=name, simple_value=value) for name, value in columns.items()]
        return Event(wall_time=self._began + row.seconds, step=row.iteration, summary=Summary(value=values))

    def _write(self, *events: Any) -> None:
        with named(self._file):
            for event in events:
                self._writer.write(event.SerializeToString())
            self._writer.flush()
