"""Workers that execute calls: processes of this machine, a Dask cluster, or a Ray cluster.

Each kind returns futures, for which one loop waits. If a worker of a cluster is lost, the cluster repeats its call on
another worker.
"""

from __future__ import annotations

import logging
import os
import re
import socket
import sys
from collections.abc import Callable, Iterable, Iterator
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

from rkhs_ros.base.endings import RunError
from rkhs_ros.base.processes import terminate_with_parent
from rkhs_ros.base.validation import require, require_extra
from rkhs_ros.runs.provenance import TASKS, provenance

ALL_CORES = -1
CONNECT_TIMEOUT_S = 10
RETRIES = 3  # of a call if its worker is lost
T = TypeVar("T")
DASK_ADDRESS = re.compile(r"\w+://\S+:\d{1,5}", re.ASCII)
RAY_ADDRESS = re.compile(r"(?:ray://)?([^\s:/]+):(\d{1,5})", re.ASCII)


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
            ValueError: a worker runs other code.
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
        ray: address of a Ray cluster, which replaces this machine.
    """

    jobs: int = ALL_CORES
    scheduler: str | None = None
    ray: str | None = None

    def __post_init__(self) -> None:
        """Raise ValueError if a number is invalid, several kinds of workers are chosen, or a library is missing."""
        expected = f"at least 1, or {ALL_CORES} for all cores"
        require(self.jobs == ALL_CORES or self.jobs >= 1, "--jobs", expected, self.jobs)
        places = {"--jobs": self.jobs != ALL_CORES, "--scheduler": self.scheduler, "--ray": self.ray}
        named = [name for name, given in places.items() if given]
        require(len(named) <= 1, "workers", f"at most one of {', '.join(places)}", " and ".join(named))
        if self.scheduler:
            require_extra("distributed", "dask", "--scheduler")
        if self.ray:
            require_extra("ray", "ray", "--ray")

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
        elif self.ray:
            opened = _ray(self.ray)
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


@contextmanager
def _ray(address: str) -> Iterator[Pool]:
    place = RAY_ADDRESS.fullmatch(address)
    if place is None:
        raise ValueError(f"--ray: expected an address such as HOST:6379 or ray://HOST:10001, got '{address}'")
    try:
        socket.create_connection(
            (place[1], int(place[2])), CONNECT_TIMEOUT_S
        ).close()  # Ray itself would retry for minutes
        ray = import_module("ray")
        ray.init(address, log_to_driver=False, logging_level=logging.ERROR)
    except (OSError, RuntimeError, ValueError) as error:
        raise OSError(f"--ray: expected a Ray cluster at {address}, got none ({error})") from error

    def submit(call: Callable[..., Any], *arguments: Any) -> Future[Any]:
        task = ray.remote(call).options(num_cpus=1, max_retries=RETRIES)
        future: Future[Any] = task.remote(*arguments).future()
        return future

    lost = (ray.exceptions.WorkerCrashedError, ray.exceptions.NodeDiedError)
    try:
        yield Pool(_with_our_code(submit), lost)
    finally:
        ray.shutdown()


def _with_our_code(submit: Callable[..., Future[Any]]) -> Callable[..., Future[Any]]:
    """Wrap a submit function so that a worker rejects calls unless its results are bit-identical to ours."""
    ours = provenance(*TASKS)
    return lambda call, *arguments: submit(_checked, ours, call, *arguments)


def _checked(expected: dict[str, str], call: Callable[..., T], *arguments: Any) -> T:
    got = provenance(*TASKS)
    for name, value in expected.items():
        require(got[name] == value, f"worker: {name}", value, got[name])
    return call(*arguments)
