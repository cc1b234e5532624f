"""Calls in parallel processes: one process executes them in sequence, and killed processes are reported."""

import os
import signal
from collections.abc import Iterator

import pytest

from rkhs_ros.studies.workers import WorkerLostError, run_parallel


def doubled(number: int) -> int:
    return 2 * number


def ended_by_signal(number: int) -> int:
    if number == 1:
        os.kill(os.getpid(), signal.SIGKILL)
    return number


def results(jobs: int) -> Iterator[int]:
    call = doubled if jobs == 1 else ended_by_signal
    return run_parallel(call, [(number,) for number in range(4)], jobs=jobs, title="calls", quiet=True)


def test_a_single_process_executes_calls_in_sequence() -> None:
    assert list(results(1)) == [0, 2, 4, 6]


@pytest.mark.slow
def test_killed_processes_are_reported() -> None:
    with pytest.raises(WorkerLostError, match="run the same command to continue"):
        list(results(2))
