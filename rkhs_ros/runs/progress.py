"""Progress display of runs: a bar in a terminal, otherwise a line every few seconds."""

import sys
import time
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from math import isnan
from pathlib import Path
from typing import Protocol

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

from rkhs_ros.learning.diagnosis import Advice
from rkhs_ros.learning.iteration import Iteration
from rkhs_ros.learning.state import settings_of
from rkhs_ros.learning.training_settings import Training

ECHO = "^C"  # printed by a terminal at Ctrl-C; beside a bar of full width it would wrap to another line
LINE_PERIOD_S = 5.0  # between lines


class Show(Protocol):
    """A function that shows an iteration, and advice if there is any."""

    def __call__(self, iteration: Iteration, advice: Advice | None = None) -> None:
        """Show the iteration."""


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
    training: Training, done: int = 0, *, quiet: bool = False, folder: Path | None = None, is_robot: bool = False
) -> Iterator[Show]:
    """Show the progress of a run on standard error; yield a function to call after each iteration.

    Args:
        training: settings of the learner.
        done: number of iterations before a resumed run.
        quiet: show nothing.
        folder: folder of the results, which each line names.
        is_robot: whether the task runs on a robot; if so, the line about the action repeat suggests a longer period.
    """
    console = bar_console(quiet=quiet)
    if console.is_terminal or console.is_jupyter or quiet:
        with _bar(training, done, console, quiet=quiet, is_robot=is_robot) as show:
            yield show
    else:
        yield _lines(training, folder, is_robot=is_robot)


@contextmanager
def _bar(training: Training, done: int, console: Console, *, quiet: bool, is_robot: bool) -> Iterator[Show]:
    with _TwoLines(*bar_columns(), console=console, disable=quiet) as progress:
        bar = progress.add_task(training.name, total=training.iterations, completed=done, returns="return -")
        mean = "-"  # last evaluation return

        def show(iteration: Iteration, advice: Advice | None = None) -> None:
            nonlocal mean
            if len(iteration.evaluation):
                mean = f"{iteration.evaluation_return:.4g}"
            text = f"return {iteration.exploration_return:.4g}, evaluation {mean}{_model(iteration)}"
            progress.update(bar, advance=1, returns=text)
            for line in _notes(iteration, training, advice, is_robot=is_robot):
                console.print(line, markup=False, highlight=False)

        yield show


def _lines(training: Training, folder: Path | None, *, is_robot: bool) -> Show:
    due = 0.0  # monotonic time, seconds
    results = f"; {folder}" if folder else ""

    def show(iteration: Iteration, advice: Advice | None = None) -> None:
        nonlocal due
        if time.monotonic() >= due or iteration.number == training.iterations:
            mean = f", evaluation {iteration.evaluation_return:.4g}" if len(iteration.evaluation) else ""
            mean += _undiscounted(iteration, training)
            line = f"{training.name}: iteration {iteration.number} of {training.iterations}, "
            text = f"{line}return {iteration.exploration_return:.4g}{mean}{_model(iteration)}{results}"
            print(text, file=sys.stderr, flush=True)
            due = time.monotonic() + LINE_PERIOD_S
        for line in _notes(iteration, training, advice, is_robot=is_robot):
            print(line, file=sys.stderr, flush=True)

    return show


def _notes(iteration: Iteration, training: Training, advice: Advice | None, *, is_robot: bool) -> Iterator[str]:
    """Yield a line with the settings that an iteration has found, and a line with the advice for it.

    A robot whose policy now holds its actions gets the period at which it would decide as often without that.
    """
    if found := " ".join(settings_of(iteration.before, iteration.known)):
        repeat = iteration.policy.action_repeat
        is_slower = is_robot and repeat not in (1, iteration.before.action_repeat)
        period = f"; a period {repeat} times as long gives the same decision rate" if is_slower else ""
        yield f"{training.name}: found {found}{period}"
    if advice is not None:
        yield f"{training.name}: iteration {iteration.number}: {advice}"


def _undiscounted(iteration: Iteration, training: Training) -> str:
    """Return the undiscounted evaluation return in brackets; empty without a discount or an evaluation."""
    shows = training.discount < 1 and len(iteration.evaluation)
    return f" (undiscounted {iteration.undiscounted_evaluation_return:.4g})" if shows else ""


def _model(iteration: Iteration) -> str:
    """Return the predicted return of the model and the error of its predecessor; empty without a model."""
    if isnan(iteration.model_return):
        return ""
    error = "" if isnan(iteration.model_error) else f" (model error {iteration.model_error:.2g})"
    return f", model {iteration.model_return:.4g}{error}"
