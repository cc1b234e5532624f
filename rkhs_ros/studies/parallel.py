"""Calls side by side, with one progress bar over them."""

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
    """Yield what the calls return, in the order in which they end.

    Args:
        call: a function of a module, for it is called in other processes, unless there is one only.
        arguments: of each call.
        workers: who make the calls.
        title: of the progress bar on stderr.
        quiet: without progress bar.
    """
    count, take = len(arguments), partial(next, iter(arguments), None)
    with workers.opened(count) as pool, progress_bar(title, count, quiet=quiet) as advance:
        for result in pool.results(call, take, most=count):
            advance()
            yield result


@contextmanager
def progress_bar(title: str, total: int, *, quiet: bool) -> Iterator[Callable[[], None]]:
    """Show a bar on stderr, and give what advances it by one; it is shown to nobody where it is quiet or of nothing."""
    hidden = quiet or total == 0
    with Progress(*bar_columns(), console=bar_console(quiet=hidden), disable=hidden) as progress:
        yield partial(progress.advance, progress.add_task(title, total=total))
