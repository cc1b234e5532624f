"""Logs of a run for other programs: its learning curve as TensorBoard event files, or as a Weights & Biases run.

A log lives in the run folder, in a folder of its own. A run that resumes writes the log anew from curve.csv, so that it
contains each finished iteration exactly once, whatever interrupted the run.
"""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from math import isfinite
from pathlib import Path
from shutil import rmtree
from typing import Any, NamedTuple, Protocol
from uuid import uuid4

from rkhs_ros.base.endings import error_message
from rkhs_ros.base.files import named
from rkhs_ros.base.validation import pick, require_extra
from rkhs_ros.runs.curve import Row

Values = Mapping[str, Any]
PROJECT = "rkhs_ros"  # of Weights & Biases, unless WANDB_PROJECT names another


class Log(Protocol):
    """A log that contains the rows so far."""

    def add(self, row: Row) -> None:
        """Write a row."""

    def close(self) -> None:
        """Write what is pending."""


class Kind(NamedTuple):
    """A kind of log.

    Attributes:
        module: module that writes it, from the extra with the name of the log.
        opened: creates the log from its folder, the rows so far, and settings to store with them by dotted name.
    """

    module: str
    opened: Callable[[Path, Sequence[Row], Values], Log]


def logs_of(folder: Path | None, names: Iterable[str] = ()) -> list[str]:
    """Return the names of the logs that a run writes: the given ones, and those that its folder contains.

    Raises:
        ValueError: a name is unknown, or the package of a log is not installed.
    """
    found = [name for name in LOGS if folder is not None and (folder / name).is_dir()]
    chosen = list(dict.fromkeys([*names, *found]))
    for name in chosen:
        require_extra(pick(name, LOGS, "log").module, name, f"--log {name}")
    return chosen


@contextmanager
def logged(
    folder: Path, names: Iterable[str], rows: Sequence[Row], settings: Values
) -> Iterator[Callable[[Row], None]]:
    """Write logs of a run until the context exits; yield a function that adds a row to all of them.

    If a log cannot be written, print a warning and continue without it, because the run matters more than its logs.

    Args:
        folder: folder of the run.
        names: names of the logs, see `logs_of`.
        rows: rows of the iterations so far.
        settings: values to store with the rows, by dotted name.
    """
    logs: dict[str, Log] = {}

    def add(row: Row) -> None:
        for name, log in list(logs.items()):
            with _optional(name, logs):
                log.add(row)

    for name in names:
        with _optional(name, logs):
            (folder / name).mkdir(parents=True, exist_ok=True)
            logs[name] = LOGS[name].opened(folder / name, rows, settings)
    try:
        yield add
    finally:
        for name, log in list(logs.items()):
            with _optional(name, logs):
                log.close()


@contextmanager
def _optional(name: str, logs: dict[str, Log]) -> Iterator[None]:
    """If the log with a name fails, print a warning and remove it."""
    try:
        yield
    except Exception as error:
        logs.pop(name, None)
        print(f"warning: --log {name}: {error_message(error)}. The run continues without this log", file=sys.stderr)


def _numbers(row: Row) -> dict[str, float]:
    """Return the finite values of a row by column, without the iteration, which is the step in a log."""
    return {name: value for name, value in row._asdict().items() if name != "iteration" and isfinite(value)}


class TensorBoardLog:
    """An event file with one event for each row. Its times leave out the pauses before a resume."""

    def __init__(self, folder: Path, rows: Sequence[Row], settings: Values) -> None:
        from tensorboardX import RecordWriter  # SummaryWriter writes in a thread, which hides errors of the disk
        from tensorboardX.proto.event_pb2 import Event, SessionLog

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
        from tensorboardX.proto.event_pb2 import Event
        from tensorboardX.proto.summary_pb2 import Summary

        values = [Summary.Value(tag=name, simple_value=value) for name, value in _numbers(row).items()]
        return Event(wall_time=self._began + row.seconds, step=row.iteration, summary=Summary(value=values))

    def _write(self, *events: Any) -> None:
        with named(self._file):
            for event in events:
                self._writer.write(event.SerializeToString())
            self._writer.flush()


class WandbLog:
    """A run of Weights & Biases, stored on this machine only unless WANDB_MODE is set, such as to ``online``."""

    def __init__(self, folder: Path, rows: Sequence[Row], settings: Values) -> None:
        import wandb

        earlier = sorted(folder.glob("*run-*-*"), key=_time_and_id)
        self._run = wandb.init(
            dir=str(folder.parent),  # wandb adds its folder
            id=_time_and_id(earlier[-1])[1] if earlier else uuid4().hex[:8],
            name=folder.parent.resolve().name,
            project=os.environ.get("WANDB_PROJECT", PROJECT),
            mode=os.environ.get("WANDB_MODE", "offline"),
            resume="allow",
            config=dict(settings),
            settings=wandb.Settings(console="off", reinit="create_new", silent=True),
        )
        for row in rows:
            self.add(row)
        if self._run.offline:
            for path in earlier:
                rmtree(path)

    def add(self, row: Row) -> None:
        """Log a row, unless a server already has it from before a resume."""
        if row.iteration >= self._run.step:
            self._run.log(_numbers(row), step=row.iteration)

    def close(self) -> None:
        """Finish the run of Weights & Biases."""
        self._run.finish()


def _time_and_id(folder: Path) -> list[str]:
    """Return the start and the id of a run from the name of its folder, such as offline-run-20261123_172110-3f2a."""
    return folder.name.rsplit("-", 2)[1:]


LOGS = {"tensorboard": Kind("tensorboardX", TensorBoardLog), "wandb": Kind("wandb", WandbLog)}
