"""Workers that execute calls: processes of this machine, or a Dask cluster.

Both return futures, for which one loop waits. If a worker of a cluster is lost, the cluster repeats its call on another
worker.
"""

import logging
import os
import re
import sys
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import CancelledError, Future
from contextlib import AbstractContextManager, contextmanager, nullcontext
from dataclasses import dataclass
from importlib import import_module
from itertools import islice
from queue import SimpleQueue
from typing import Any, NamedTuple, TypeVar

from joblib import cpu_count
from joblib.externals.loky import get_reusable_executor
from joblib.externals.loky.process_executor import BrokenProcessPool
from rich.progress import Progress

from rkhs_ros.base.endings import RunError
from rkhs_ros.base.processes import terminate_with_parent
from rkhs_ros.base.validation import require, require_extra
from rkhs_ros.runs.progress import bar_columns, bar_console
from rkhs_ros.runs.provenance import provenance

ALL_CORES = -1
CONNECT_TIMEOUT_S = 10
T = TypeVar("T")
DASK_ADDRESS = re.compile(r"\w+://\S+:\d{1,5}", re.ASCII)


class WorkerLostError(RunError):
    """Raised if the worker of a call was killed and no other worker could execute the call."""


class Pool(NamedTuple):
    """A pool of workers.

    Attributes:
        submit: starts a call of a module's function and returns its future.
        lost: errors of futures whose workers were lost.
        most: maximum number of submitted calls, including those that wait for a worker.
    """

    submit: Callable[..., Future[Any]]
    lost: tuple[type[BaseException], ...]
    most: int = sys.maxsize

    def results(self, call: Callable[..., T], arguments: Iterable[tuple[Any, ...]]) -> Iterator[T]:
        """Yield the results of calls in order of completion.

        Args:
            call: the function.
            arguments: arguments of each call.

        Raises:
            WorkerLostError: some calls could not be executed; raised after all others completed.
            ValueError: a worker has other versions.
        """
        ended: SimpleQueue[Future[T]] = SimpleQueue()
        missing, submitted = iter(arguments), 0
        lost: BaseException | None = None
        while True:
            try:
                for each in islice(missing, self.most - submitted):
                    self.submit(call, *each).add_done_callback(ended.put)
                    submitted += 1
            except self.lost as error:  # submit no more calls
                lost, missing = error, iter(())
            if submitted == 0:
                break
            future = ended.get()
            submitted -= 1
            try:
                result = future.result()
            except self.lost as error:
                lost = error
                continue
            yield result
        if lost is not None:
            raise WorkerLostError("a worker process was killed; run the same command to continue") from lost


@dataclass(frozen=True)
class Workers:
    """Choice of the workers that execute calls in parallel.

    Attributes:
        jobs: number of processes on this machine; -1 for one per core.
        scheduler: address of a Dask scheduler, whose cluster replaces this machine.
    """

    jobs: int = ALL_CORES
    scheduler: str | None = None

    def __post_init__(self) -> None:
        """Raise ValueError if a number is invalid, both kinds of workers are chosen, or Dask is missing."""
        expected = f"at least 1, or {ALL_CORES} for all cores"
        require(self.jobs == ALL_CORES or self.jobs >= 1, "--jobs", expected, self.jobs)
        both = self.jobs != ALL_CORES and bool(self.scheduler)
        require(not both, "workers", "either --jobs or --scheduler", "both")
        if self.scheduler:
            require_extra("distributed", "dask", "--scheduler")

    @contextmanager
    def opened(self, count: int) -> Iterator[Pool]:
        """Yield a pool for a number of calls.

        Raises:
            OSError: the cluster cannot be reached.
            ValueError: the workers of the cluster have several threads.
        """
        processes = min(cpu_count() if self.jobs == ALL_CORES else self.jobs, count)
        if self.scheduler:
            opened: AbstractContextManager[Pool] = _dask(self.scheduler)
        elif processes > 1:
            opened = _processes(processes)
        else:
            opened = nullcontext(Pool(_made, (), most=1))
        with opened as pool:
            yield pool


def _made(call: Callable[..., T], *arguments: Any) -> Future[T]:
    """Execute a call in this process."""
    future: Future[T] = Future()
    future.set_result(call(*arguments))
    return future


@contextmanager
def _processes(count: int) -> Iterator[Pool]:
    executor = get_reusable_executor(count, initializer=terminate_with_parent, initargs=(os.getpid(),), reuse=False)
    try:
        yield Pool(executor.submit, (BrokenProcessPool,))
    finally:
        executor.shutdown(kill_workers=True)


@contextmanager
def _dask(address: str) -> Iterator[Pool]:
    distributed = import_module("distributed")
    require(
        DASK_ADDRESS.fullmatch(address) is not None, "--scheduler", "an address such as tcp://HOST:8786", f"'{address}'"
    )
    try:
        client = distributed.Client(address, timeout=CONNECT_TIMEOUT_S, set_as_default=False)
    except OSError as error:
        raise OSError(f"--scheduler: expected a Dask scheduler at {address}, got none ({error})") from error
    logging.getLogger("distributed.client").setLevel(logging.CRITICAL)  # a lost scheduler is reported in one line
    with client:
        executor = client.get_executor(pure=False)
        most = max(client.nthreads().values(), default=1)
        require(most == 1, "--scheduler", "workers of one thread (dask worker --nthreads 1)", f"{most} threads")
        lost = (distributed.scheduler.KilledWorker, CancelledError)
        try:
            yield Pool(_with_our_code(executor.submit), lost)
        finally:
            executor.shutdown(wait=False)


def _with_our_code(submit: Callable[..., Future[Any]]) -> Callable[..., Future[Any]]:
    """Wrap a submit function so that a worker with other versions, whose results may differ, rejects calls."""
    return lambda call, *arguments: submit(_checked, provenance(), call, *arguments)


def _checked(expected: dict[str, str], call: Callable[..., T], *arguments: Any) -> T:
    got = provenance()
    for name, value in expected.items():
        require(got[name] == value, f"worker: {name}", value, got[name])
    return call(*arguments)


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
