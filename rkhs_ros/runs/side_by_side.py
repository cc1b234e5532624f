"""Calls side by side in other processes, with one progress bar over them."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import as_completed
from typing import Any, TypeVar

from joblib import cpu_count
from joblib.externals.loky import get_reusable_executor
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from rkhs_ros.base.processes import terminate_with_parent
from rkhs_ros.base.validation import require
from rkhs_ros.runs.progress import bar_console

ALL_CORES = -1
T = TypeVar("T")


def check_jobs(jobs: int) -> None:
    """Raise ValueError where this is no number of processes."""
    require(jobs == ALL_CORES or jobs >= 1, "--jobs", f"at least 1, or {ALL_CORES} for all cores", jobs)


def side_by_side(
    call: Callable[..., T], arguments: Sequence[tuple[Any, ...]], *, jobs: int, title: str, quiet: bool
) -> Iterator[T]:
    """Yield what the calls return, in the order in which they end.

    Args:
        call: a function of a module, for it is called in other processes, unless there is one only.
        arguments: of each call.
        jobs: number of processes; -1 for one per core.
        title: of the progress bar on stderr.
        quiet: without progress bar.
    """
    columns = (TextColumn("{task.description}", markup=False), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
    hidden = quiet or not arguments
    console = bar_console(quiet=hidden)
    with Progress(*columns, TimeRemainingColumn(), console=console, disable=hidden) as progress:
        bar = progress.add_task(title, total=len(arguments))
        for result in _results(call, arguments, cpu_count() if jobs == ALL_CORES else jobs):
            progress.advance(bar)
            yield result


def _results(call: Callable[..., T], arguments: Sequence[tuple[Any, ...]], processes: int) -> Iterator[T]:
    processes = min(processes, len(arguments))
    if processes <= 1:
        yield from (call(*each) for each in arguments)
        return
    executor = get_reusable_executor(processes, initializer=terminate_with_parent, initargs=(os.getpid(),), reuse=False)
    try:
        for future in as_completed([executor.submit(call, *each) for each in arguments]):
            yield future.result()
    finally:
        executor.shutdown(kill_workers=True)
