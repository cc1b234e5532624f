"""Calls in parallel: in processes of this machine, or on a Dask cluster."""

import os
import signal
import sys
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, CancelledError, Executor, Future, wait
from contextlib import contextmanager
from importlib import import_module
from itertools import islice
from multiprocessing import resource_tracker
from typing import Any, TypeVar

from joblib import cpu_count
from joblib.externals.loky import get_reusable_executor
from joblib.externals.loky.backend import resource_tracker as loky_resource_tracker
from joblib.externals.loky.process_executor import BrokenProcessPool
from rich.progress import Progress

from rkhs_ros.base.endings import RunError, deferred_signals
from rkhs_ros.base.processes import terminate_with_parent
from rkhs_ros.base.validation import require, require_extra
from rkhs_ros.runs.progress import bar_columns, bar_console

CONNECT_TIMEOUT_S = 10
LOST = "a worker process was killed; run the same command to continue"
SAME_ON_ALL = ["rkhs_ros", "numpy", "scipy"]  # packages of which the workers of a cluster have our versions
T = TypeVar("T")


class WorkerLostError(RunError):
    """Raised if a worker process was killed."""


def run_parallel(
    call: Callable[..., T], arguments: Sequence[tuple[Any, ...]], *, jobs: int | str | None, title: str, quiet: bool
) -> Iterator[T]:
    """Call a function in parallel and yield the results in order of completion.

    The function is at the top level of a module, so that other processes can import it. ``jobs`` is the number of
    processes: 1 executes the calls in this process, None stands for one per core, and a text is the address of a Dask
    scheduler, whose cluster replaces this machine.
    """
    hidden = quiet or not arguments
    with Progress(*bar_columns(), console=bar_console(quiet=hidden), disable=hidden) as progress:
        bar = progress.add_task(title, total=len(arguments))
        for result in _results(call, arguments, jobs):
            progress.advance(bar)
            yield result


def _results(call: Callable[..., T], arguments: Sequence[tuple[Any, ...]], jobs: int | str | None) -> Iterator[T]:
    processes = 0 if isinstance(jobs, str) else min(jobs or cpu_count(), len(arguments))
    if not arguments or processes == 1:
        yield from (call(*each) for each in arguments)
        return
    with _cluster(jobs) if isinstance(jobs, str) else _processes(processes) as executor:
        waiting = iter(arguments)  # not in the executor of processes, whose end would print a traceback for them
        at_once = processes or len(arguments)
        running = {_submitted(executor, call, each) for each in islice(waiting, at_once)}
        while running:
            done, running = wait(running, return_when=FIRST_COMPLETED)
            for future in done:  # before further calls, since the executor does not end well just after one
                yield future.result()
            running |= {_submitted(executor, call, each) for each in islice(waiting, len(done))}


def _submitted(executor: Executor, call: Callable[..., T], arguments: tuple[Any, ...]) -> Future[T]:
    """Submit a call; block SIGINT in the processes that this starts, since a terminal sends it to them as well."""
    with deferred_signals():  # until the executor knows all its processes, which it has to end
        before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
        try:
            return executor.submit(call, *arguments)
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, before)


@contextmanager
def _processes(count: int) -> Iterator[Executor]:
    for tracker in (resource_tracker, loky_resource_tracker):
        tracker.ensure_running()  # now, since their start unblocks SIGINT
    executor = get_reusable_executor(count, initializer=terminate_with_parent, initargs=(os.getpid(),), reuse=False)
    try:
        yield executor
    except BrokenProcessPool as error:
        raise WorkerLostError(LOST) from error
    finally:
        executor.shutdown(kill_workers=True)


@contextmanager
def _cluster(address: str) -> Iterator[Executor]:
    require_extra("distributed", "dask", "--jobs")
    distributed = import_module("distributed")
    try:
        client = distributed.Client(address, timeout=CONNECT_TIMEOUT_S, set_as_default=False)
    except (OSError, ValueError) as error:
        raise OSError(f"--jobs: expected a Dask scheduler at {address}, got none ({error})") from error
    with client:
        client.get_versions(check=True, packages=SAME_ON_ALL)
        threads = client.nthreads()
        if not threads:
            print(f"waiting for workers at {address}", file=sys.stderr, flush=True)
        most = max(threads.values(), default=1)
        require(most == 1, "--jobs", "workers of one thread (dask worker --nthreads 1)", f"{most} threads")
        executor = client.get_executor(pure=False)
        try:
            yield executor
        except (distributed.scheduler.KilledWorker, CancelledError) as error:
            raise WorkerLostError(LOST) from error
        finally:
            executor.shutdown(wait=False)
