"""A whole run with its results: the training loop, the progress bar, and the files it leaves."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

from rkhs_ros.experiments.config import Config
from rkhs_ros.experiments.report import Report, new_folder
from rkhs_ros.experiments.training import Iteration, Runner, train


def run_training(config: Config, runner: Runner, folder: Path | None, *, quiet: bool = False) -> Path:
    """Train and write the results.

    Args:
        config: the run.
        runner: who lets the policies act.
        folder: where the results go; results/NAME/TIME where None.
        quiet: without progress bar.

    Returns:
        The folder of the results.

    Raises:
        ValueError: the folder holds something already.
        OSError: the folder cannot be written.
    """
    report = Report(new_folder(folder, config.training.name), config)
    try:
        with _progress(config, quiet) as show:
            for iteration in train(config.training, runner):
                report.add(iteration)
                show(iteration)
    finally:
        report.finish()  # what was learnt before an interruption is kept
    return report.folder


@contextmanager
def _progress(config: Config, quiet: bool) -> Iterator[Callable[[Iteration], None]]:
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
    text = TextColumn("return {task.fields[train]}, noise-free {task.fields[mean]}")
    with Progress(*columns, text, console=Console(file=sys.stderr), disable=quiet) as progress:
        task = progress.add_task(config.training.name, total=config.training.iterations, train="-", mean="-")

        def show(iteration: Iteration) -> None:
            train_return, mean_return = iteration.train_returns.mean(), iteration.mean_policy_returns.mean()
            progress.update(task, advance=1, train=f"{train_return:.2f}", mean=f"{mean_return:.2f}")

        yield show
