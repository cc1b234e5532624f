"""Parallel calls with a common progress bar."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import partial
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
    count, take = len(arguments), partial(next, iter(arguments), None)
    with workers.opened(count) as pool, progress_bar(title, count, quiet=quiet) as advance:
        for result in pool.results(call, take, most=count):
            advance()
            yield result


@contextmanager
def progress_bar(title: str, total: int, *, quiet: bool) -> Iterator[Callable[[], None]]:
    """Show a bar on stderr and yield a function that advances it by one; hide the bar if quiet or if total is 0."""
    hidden = quiet or total == 0
    with Progress(*bar_columns(), console=bar_console(quiet=hidden), disable=hidden) as progress:
        yield partial(progress.advance, progress.add_task(title, total=total))
