"""Calls side by side, with one progress bar over them."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import Any, TypeVar

from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from rkhs_ros.runs.progress import bar_console
from rkhs_ros.runs.workers import Workers

T = TypeVar("T")


def side_by_side(
    call: Callable[..., T], arguments: Sequence[tuple[Any, ...]], *, workers: Workers, title: str, quiet: bool
) -> Iterator[T]:
    """Yield what the calls return, in the order in which they end.

    Args:
        call: a function of a module, for it is called in other processes, unless there is one only.
        arguments: of each call.
        workers: who make the calls.
        title: of the progress bar on stderr.
        quiet: without progress bar.
    """
    columns = (TextColumn("{task.description}", markup=False), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
    hidden = quiet or not arguments
    console = bar_console(quiet=hidden)
    bars = Progress(*columns, TimeRemainingColumn(), console=console, disable=hidden)
    with workers.opened(len(arguments)) as results, bars as progress:
        bar = progress.add_task(title, total=len(arguments))
        for result in results(call, arguments):
            progress.advance(bar)
            yield result
