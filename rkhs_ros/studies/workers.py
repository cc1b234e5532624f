"""Calls in parallel processes of this machine."""

import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import as_completed
from typing import Any, TypeVar

from joblib import cpu_count
from joblib.externals.loky import get_reusable_executor
from joblib.externals.loky.process_executor import BrokenProcessPool
from rich.progress import Progress

from rkhs_ros.base.endings import RunError
from rkhs_ros.base.processes import terminate_with_parent
from rkhs_ros.runs.progress import bar_columns, bar_console

T = TypeVar("T")


class WorkerLostError(RunError):
    """Raised if a worker process was killed."""


def run_parallel(
    call: Callable[..., T], arguments: Sequence[tuple[Any, ...]], *, jobs: int | None, title: str, quiet: bool
) -> Iterator[T]:
    """Call a function in parallel and yield the results in order of completion.

    Args:
        call: a function at the top level of a module, so that other processes can import it.
        arguments: arguments of each call.
        jobs: number of processes; 1 executes the calls in this process, None stands for one per core.
        title: title of the progress bar on stderr.
        quiet: show no progress bar.

    Raises:
        WorkerLostError: a worker process was killed.
    """
    hidden = quiet or not arguments
    with Progress(*bar_columns(), console=bar_console(quiet=hidden), disable=hidden) as progress:
        bar = progress.add_task(title, total=len(arguments))
        for result in _results(call, arguments, min(jobs or cpu_count(), len(arguments))):
            progress.advance(bar)
            yield result


def _results(call: Callable[..., T], arguments: Sequence[tuple[Any, ...]], processes: int) -> Iterator[T]:
    if processes <= 1:
        yield from (call(*each) for each in arguments)
        return
    executor = get_reusable_executor(processes, initializer=terminate_with_parent, initargs=(os.getpid(),), reuse=False)
    try:
        for future in as_completed([executor.submit(call, *each) for each in arguments]):
            yield future.result()
    except BrokenProcessPool as error:
        raise WorkerLostError("a worker process was killed; run the same command to continue") from error
    finally:
        executor.shutdown(kill_workers=True)
