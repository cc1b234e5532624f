"""The progress of runs: a bar where there is a terminal, else a line every few seconds."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from math import isnan
from pathlib import Path

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

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
    columns = (
        TextColumn("{task.description}", markup=False),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
    )
    text = TextColumn("return {task.fields[train]}, noise-free {task.fields[mean]}{task.fields[imagined]}")
    with Progress(*columns, text, console=console, disable=quiet) as progress:
        task = progress.add_task(
            training.name, total=training.iterations, completed=done, train="-", mean="-", imagined=""
        )

        def show(iteration: Iteration) -> None:
            progress.update(task, advance=1, train=f"{iteration.train_return:.4g}")
            if len(iteration.evaluation):
                progress.update(task, mean=f"{iteration.mean_policy_return:.4g}")
            progress.update(task, imagined=_imagined(iteration))

        yield show


def _lines(training: Training, folder: Path | None) -> Show:
    due = 0.0  # monotonic time, seconds
    where = f"; {folder}" if folder else ""

    def show(iteration: Iteration) -> None:
        nonlocal due
        if time.monotonic() >= due or iteration.number == training.iterations:
            mean = f", noise-free {iteration.mean_policy_return:.4g}" if len(iteration.evaluation) else ""
            line = f"{training.name}: iteration {iteration.number} of {training.iterations}, "
            text = f"{line}return {iteration.train_return:.4g}{mean}{_imagined(iteration)}{where}"
            print(text, file=sys.stderr, flush=True)
            due = time.monotonic() + LINE_PERIOD_S

    return show


def _imagined(iteration: Iteration) -> str:
    """Return what the model promises, and how far off the one before it was; nothing without practice."""
    if isnan(iteration.imagined_return):
        return ""
    error = "" if isnan(iteration.model_error) else f" (model error {iteration.model_error:.2g})"
    return f", imagined {iteration.imagined_return:.4g}{error}"
