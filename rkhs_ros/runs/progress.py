"""The progress of runs: a bar where there is a terminal, else a line every few seconds."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from math import isnan
from pathlib import Path

from rich.console import Console, RenderableType
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    ProgressColumn,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)
from rich.table import Column
from rich.text import Text

from rkhs_ros.learning.training import Iteration
from rkhs_ros.learning.training_settings import Training

ECHO = "^C"  # that a terminal shows at Ctrl-C; beside a bar as wide as itself it would do so on another line
LINE_PERIOD_S = 5.0  # between lines
Show = Callable[[Iteration], None]


def bar_console(*, quiet: bool) -> Console:
    """Return a console on standard error for a progress bar that a Ctrl-C does not double."""
    console = Console(file=sys.stderr, quiet=quiet)
    console.width -= len(ECHO) + 1
    return console


def bar_columns() -> tuple[ProgressColumn, ...]:
    """Return the columns of a bar; in a narrow terminal the title and the bar shrink, the numbers stay."""
    return (
        TextColumn("{task.description}", markup=False, table_column=Column(no_wrap=False, overflow="ellipsis")),
        BarColumn(table_column=Column(no_wrap=False)),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
    )


class _TwoLines(Progress):
    """A bar with the returns on a line of their own, so that both fit a terminal of 80 columns."""

    def get_renderables(self) -> Iterable[RenderableType]:
        """Return the bar and the line below it."""
        yield self.make_tasks_table(self.tasks)
        yield from (Text(task.fields["returns"]) for task in self.tasks)


@contextmanager
def progress_bar(
    training: Training, done: int = 0, *, quiet: bool = False, folder: Path | None = None
) -> Iterator[Show]:
    """Show how far a run is, on standard error; yield what is told of each iteration.

    Args:
        training: the learner's settings.
        done: iterations made before.
        quiet: show nothing.
        folder: of the results, which lines name.
    """
    console = bar_console(quiet=quiet)
    if console.is_terminal or console.is_jupyter or quiet:
        with _bar(training, done, console, quiet=quiet) as show:
            yield show
    else:
        yield _lines(training, folder)


@contextmanager
def _bar(training: Training, done: int, console: Console, *, quiet: bool) -> Iterator[Show]:
    with _TwoLines(*bar_columns(), console=console, disable=quiet) as progress:
        bar = progress.add_task(training.name, total=training.iterations, completed=done, returns="return -")
        mean = "-"  # evaluation return that was measured last

        def show(iteration: Iteration) -> None:
            nonlocal mean
            if len(iteration.evaluation):
                mean = f"{iteration.evaluation_return:.4g}"
            text = f"return {iteration.exploration_return:.4g}, noise-free {mean}{_imagined(iteration)}"
            progress.update(bar, advance=1, returns=text)

        yield show


def _lines(training: Training, folder: Path | None) -> Show:
    due = 0.0  # monotonic time, seconds
    where = f"; {folder}" if folder else ""

    def show(iteration: Iteration) -> None:
        nonlocal due
        if time.monotonic() >= due or iteration.number == training.iterations:
            mean = f", noise-free {iteration.evaluation_return:.4g}" if len(iteration.evaluation) else ""
            line = f"{training.name}: iteration {iteration.number} of {training.iterations}, "
            text = f"{line}return {iteration.exploration_return:.4g}{mean}{_imagined(iteration)}{where}"
            print(text, file=sys.stderr, flush=True)
            due = time.monotonic() + LINE_PERIOD_S

    return show


def _imagined(iteration: Iteration) -> str:
    """Return what the model promises, and how far off the one before it was; nothing without a model."""
    if isnan(iteration.model_return):
        return ""
    error = "" if isnan(iteration.model_error) else f" (model error {iteration.model_error:.2g})"
    return f", imagined {iteration.model_return:.4g}{error}"
