"""Calls side by side in other processes, with one progress bar over them."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import Any, TypeVar

from joblib import Parallel, delayed
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
        call: a function of a module, for it is called in other processes, each with one BLAS thread.
        arguments: of each call.
        jobs: number of processes; -1 for one per core.
        title: of the progress bar on stderr.
        quiet: without progress bar.
    """
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
    workers = {"inner_max_num_threads": 1, "initializer": terminate_with_parent}
    parallel = Parallel(jobs, "loky", return_as="generator_unordered", **workers)
    console, hidden = bar_console(), quiet or not arguments
    with Progress(*columns, TimeRemainingColumn(), console=console, disable=hidden) as progress:
        bar = progress.add_task(title, total=len(arguments))
        for result in parallel(delayed(call)(*each) for each in arguments):
            progress.advance(bar)
            yield result
