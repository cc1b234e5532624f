"""Progress display of runs: a bar in a terminal, otherwise at most a line per second."""

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

from rkhs_ros.learning.iteration import Iteration, with_error
from rkhs_ros.learning.state import settings_of
from rkhs_ros.learning.training_settings import Training

ECHO = "^C"  # printed by a terminal at Ctrl-C; beside a bar of full width it would wrap to another line
LINE_PERIOD_S = 1.0  # between lines
Show = Callable[..., None]  # shows an iteration, and advice if there is any


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

    A resumed run has ``done`` iterations; each line names the folder of the results.
    """
    console = bar_console(quiet=quiet)
    is_bar = console.is_terminal or console.is_jupyter
    evaluation, due = "-", 0.0  # last evaluation return; monotonic time of the next line in seconds
    with _TwoLines(*bar_columns(), console=console, disable=quiet or not is_bar) as progress:
        bar = progress.add_task(training.name, total=training.iterations, completed=done, returns="returns: -")

        def show(iteration: Iteration, advice: str | None = None) -> None:
            nonlocal evaluation, due
            if len(iteration.evaluation):
                evaluation = with_error(iteration.evaluation_return, iteration.evaluation_error)
            returns = (
                f"returns: exploration {iteration.exploration_return:.4g}, evaluation {evaluation}{_model(iteration)}"
            )
            progress.update(bar, advance=1, returns=returns)
            count = f"{training.name}: iteration {iteration.number}"
            found = " ".join(settings_of(iteration.before, iteration.known))
            lines = [f"{count}: found {found}"] if found else []
            lines += [f"{count}: {advice}"] if advice is not None else []
            if not is_bar and (time.monotonic() >= due or iteration.number == training.iterations):
                results = f"; {folder}" if folder else ""
                lines.insert(0, f"{count} of {training.iterations}, {returns}{results}")
                due = time.monotonic() + LINE_PERIOD_S
            for line in lines:
                console.print(line, markup=False, highlight=False, soft_wrap=True)

        yield show


def _model(iteration: Iteration) -> str:
    """Return the predicted return of the model and the error of its predecessor; empty without a model."""
    if isnan(iteration.model_return):
        return ""
    error = "" if isnan(iteration.model_error) else f" (error {iteration.model_error:.2g})"
    return f", model {iteration.model_return:.4g}{error}"
