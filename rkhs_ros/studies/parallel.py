"""Parallel calls with a common progress bar."""

from collections.abc import Callable, Iterator, Sequence
from typing import Any, TypeVar

from rich.progress import Progress

from rkhs_ros.runs.progress import bar_columns, bar_console
from rkhs_ros.studies.workers import Workers

T = TypeVar("T")


def run_parallel(
    call: Callable[..., T], arguments: Sequence[tuple[Any, ...]], *, workers: Workers, title: str, quiet: bool
) -> Iterator[T]:
    """Call a function in parallel and yield the results in order of completion.

    Args:
        call: a function at the top level of a module, so that other processes can import it.
        arguments: arguments of each call.
        workers: workers that execute the calls.
        title: title of the progress bar on stderr.
        quiet: show no progress bar.
    """
    hidden = quiet or not arguments
    progress = Progress(*bar_columns(), console=bar_console(quiet=hidden), disable=hidden)
    with workers.opened(len(arguments)) as pool, progress:
        bar = progress.add_task(title, total=len(arguments))
        for result in pool.results(call, arguments):
            progress.advance(bar)
            yield result
