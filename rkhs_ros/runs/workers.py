"""Where calls are made: in processes of this machine, on a Dask cluster, or on a Ray cluster.

Each gives futures, which one loop waits for. A cluster makes a call whose worker was lost again on another.
"""

from __future__ import annotations

import logging
import os
import re
import socket
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import CancelledError, Future, as_completed
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from importlib import import_module
from importlib.util import find_spec
from typing import Any, NamedTuple, TypeVar

from joblib import cpu_count
from joblib.externals.loky import get_reusable_executor
from joblib.externals.loky.process_executor import BrokenProcessPool

from rkhs_ros.base.endings import RunError
from rkhs_ros.base.processes import terminate_with_parent
from rkhs_ros.base.validation import require
from rkhs_ros.runs.surroundings import TASKS, surroundings

ALL_CORES = -1
CONNECT_TIMEOUT_S = 10
RETRIES = 3  # of a call whose worker was lost
T = TypeVar("T")
Results = Callable[[Callable[..., T], Sequence[tuple[Any, ...]]], Iterator[T]]
DASK_ADDRESS = re.compile(r"\w+://\S+:\d{1,5}", re.ASCII)
RAY_ADDRESS = re.compile(r"(?:ray://)?([^\s:/]+):(\d{1,5})", re.ASCII)


class WorkerLostError(RunError):
    """A call's worker was killed, and no other could make it."""


class Pool(NamedTuple):
    """What takes calls.

    Attributes:
        submit: begins a call of a module's function and returns its future.
        lost: errors of the futures whose workers were lost for good.
    """

    submit: Callable[..., Future[Any]]
    lost: tuple[type[BaseException], ...]


@dataclass(frozen=True)
class Workers:
    """Where calls are made side by side.

    Attributes:
        jobs: processes of this machine; -1 for one per core.
        scheduler: address of a Dask scheduler, whose cluster takes the place of this machine.
        ray: address of a Ray cluster, which takes the place of this machine.
    """

    jobs: int = ALL_CORES
    scheduler: str | None = None
    ray: str | None = None

    def __post_init__(self) -> None:
        """Raise ValueError where there is no such number, more than one place, or a library is not installed."""
        expected = f"at least 1, or {ALL_CORES} for all cores"
        require(self.jobs == ALL_CORES or self.jobs >= 1, "--jobs", expected, self.jobs)
        places = {"--jobs": self.jobs != ALL_CORES, "--scheduler": self.scheduler, "--ray": self.ray}
        named = [name for name, given in places.items() if given]
        require(len(named) <= 1, "workers", f"one of {', '.join(places)}", " and ".join(named))
        if self.scheduler:
            require_extra("distributed", "dask", "--scheduler")
        if self.ray:
            require_extra("ray", "ray", "--ray")

    @contextmanager
    def opened(self, count: int) -> Iterator[Results[Any]]:
        """Give what makes a number of calls and yields what they return, in the order in which they end.

        It raises WorkerLostError where some could not be made, after all others have been, and ValueError where a
        worker has other code.

        Raises:
            OSError: the cluster cannot be reached.
            ValueError: its workers have several threads.
        """
        processes = min(cpu_count() if self.jobs == ALL_CORES else self.jobs, count)
        if self.scheduler:
            opened = _dask(self.scheduler)
        elif self.ray:
            opened = _ray(self.ray)
        elif processes > 1:
            opened = _processes(processes)
        else:
            yield lambda call, arguments: (call(*each) for each in arguments)
            return
        with opened as pool:
            yield partial(_as_they_end, pool)


def require_extra(module: str, extra: str, what: str) -> None:
    """Raise ValueError, with what to install, where a module is missing."""
    remedy = f"{module} to be installed (pip install {module}, or the extra '{extra}')"
    require(find_spec(module) is not None, what, remedy, "none")


def _as_they_end(pool: Pool, call: Callable[..., T], arguments: Sequence[tuple[Any, ...]]) -> Iterator[T]:
    lost: BaseException | None = None
    for future in as_completed([pool.submit(call, *each) for each in arguments]):
        try:
            result = future.result()
        except pool.lost as error:
            lost = error
            continue
        yield result
    if lost is not None:
        raise WorkerLostError("the process of a run was killed, or one beside it; the same command goes on") from lost


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
    require(DASK_ADDRESS.fullmatch(address) is not None, "--scheduler", "an address as tcp://HOST:8786", f"'{address}'")
    try:
        client = distributed.Client(address, timeout=CONNECT_TIMEOUT_S, set_as_default=False)
    except OSError as error:
        raise OSError(f"--scheduler: expected a Dask scheduler at {address}, got none ({error})") from error
    logging.getLogger("distributed.client").setLevel(logging.CRITICAL)  # a scheduler that is lost is told of in a line
    with client:
        executor = client.get_executor(pure=False)
        threads = max(client.nthreads().values(), default=1)
        require(threads == 1, "--scheduler", "workers of one thread (dask worker --nthreads 1)", f"{threads} threads")
        try:
            yield Pool(_with_our_code(executor.submit), (distributed.scheduler.KilledWorker, CancelledError))
        finally:
            executor.shutdown(wait=False)


@contextmanager
def _ray(address: str) -> Iterator[Pool]:
    place = RAY_ADDRESS.fullmatch(address)
    if place is None:
        raise ValueError(f"--ray: expected an address as HOST:6379 or ray://HOST:10001, got '{address}'")
    try:
        socket.create_connection((place[1], int(place[2])), CONNECT_TIMEOUT_S).close()  # Ray would try for minutes
        ray = import_module("ray")
        ray.init(address, log_to_driver=False, logging_level=logging.ERROR)
    except (OSError, RuntimeError, ValueError) as error:
        raise OSError(f"--ray: expected a Ray cluster at {address}, got none ({error})") from error

    def submit(call: Callable[..., Any], *arguments: Any) -> Future[Any]:
        task = ray.remote(call).options(num_cpus=1, max_retries=RETRIES)
        future: Future[Any] = task.remote(*arguments).future()
        return future

    try:
        yield Pool(_with_our_code(submit), (ray.exceptions.WorkerCrashedError, ray.exceptions.NodeDiedError))
    finally:
        ray.shutdown()


def _with_our_code(submit: Callable[..., Future[Any]]) -> Callable[..., Future[Any]]:
    """Have a worker refuse calls where it would not come to the same bits as this process."""
    ours = surroundings(*TASKS)
    return lambda call, *arguments: submit(_checked, ours, call, *arguments)


def _checked(expected: dict[str, str], call: Callable[..., T], *arguments: Any) -> T:
    got = surroundings(*TASKS)
    for name, value in expected.items():
        require(got[name] == value, f"worker: {name}", value, got[name])
    return call(*arguments)
