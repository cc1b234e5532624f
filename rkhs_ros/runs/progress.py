"""Progress display of runs: a bar in a terminal, otherwise a line every few seconds."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import replace
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

from rkhs_ros.learning.discovery.action_repeat import change_per_decision
from rkhs_ros.learning.training import Iteration
from rkhs_ros.learning.training_settings import AUTO, Training

ECHO = "^C"  # printed by a terminal at Ctrl-C; beside a bar of full width it would wrap to another line
LINE_PERIOD_S = 5.0  # between lines
Show = Callable[[Iteration], None]


def bar_console(*, quiet: bool) -> Console:
    """Return a console on standard error for a progress bar, narrow enough that Ctrl-C does not print the bar twice."""
    console = Console(file=sys.stderr, quiet=quiet)
    console.width -= len(ECHO) + 1
    return console


def bar_columns() -> tuple[ProgressColumn, ...]:
    """Return the columns of a bar; in a narrow terminal, the title and the bar shrink."""
    return (
        TextColumn("{task.description}", markup=False, table_column=Column(no_wrap=False, overflow="ellipsis")),
        BarColumn(table_column=Column(no_wrap=False)),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
    )


class _TwoLines(Progress):
    """Progress bar with the returns on a separate line, so that both fit into 80 columns."""

    def get_renderables(self) -> Iterable[RenderableType]:
        """Return the bar and the line below it."""
        yield self.make_tasks_table(self.tasks)
        yield from (Text(task.fields["returns"]) for task in self.tasks)


@contextmanager
def progress_bar(
    training: Training, done: int = 0, *, quiet: bool = False, folder: Path | None = None
) -> Iterator[Show]:
    """Show the progress of a run on standard error; yield a function to call after each iteration.

    Args:
        training: settings of the learner.
        done: number of iterations before a resumed run.
        quiet: show nothing.
        folder: folder of the results, which each line names.
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
        mean = "-"  # last evaluation return

        def show(iteration: Iteration) -> None:
            nonlocal mean
            if len(iteration.evaluation):
                mean = f"{iteration.evaluation_return:.4g}"
            text = f"return {iteration.exploration_return:.4g}, evaluation {mean}{_model(iteration)}"
            progress.update(bar, advance=1, returns=text)
            if chosen := _action_repeat(training, iteration):
                console.print(f"{training.name}: {chosen}", markup=False, highlight=False)

        yield show


def _lines(training: Training, folder: Path | None) -> Show:
    due = 0.0  # monotonic time, seconds
    results = f"; {folder}" if folder else ""

    def show(iteration: Iteration) -> None:
        nonlocal due
        if time.monotonic() >= due or iteration.number == training.iterations:
            mean = f", evaluation {iteration.evaluation_return:.4g}" if len(iteration.evaluation) else ""
            line = f"{training.name}: iteration {iteration.number} of {training.iterations}, "
            chosen = _action_repeat(training, iteration)
            chosen = f", {chosen}" if chosen else ""
            text = f"{line}return {iteration.exploration_return:.4g}{mean}{_model(iteration)}{chosen}{results}"
            print(text, file=sys.stderr, flush=True)
            due = time.monotonic() + LINE_PERIOD_S

    return show


def _action_repeat(training: Training, iteration: Iteration) -> str:
    """Return the action repeat that the first iteration chose, and the change per decision; otherwise empty."""
    if training.action_repeat != AUTO or iteration.number > 1:
        return ""
    repeat, inputs = iteration.policy.action_repeat, iteration.policy.inputs
    features = replace(iteration.exploration, observations=inputs.features(iteration.exploration.observations))
    return f"action_repeat {repeat} (change per decision {change_per_decision(features, repeat):.2f} sd)"


def _model(iteration: Iteration) -> str:
    """Return the predicted return of the model and the error of its predecessor; empty without a model."""
    if isnan(iteration.model_return):
        return ""
    error = "" if isnan(iteration.model_error) else f" (model error {iteration.model_error:.2g})"
    return f", model {iteration.model_return:.4g}{error}"
