"""Workers of a study: rejected options, and the distribution of calls."""

import os
import signal
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from rkhs_ros.runs import provenance
from rkhs_ros.studies.workers import WorkerLostError, Workers
from test.unit.conftest import Result, assert_refused

pytestmark = pytest.mark.nightly

CONFIG = Path(__file__).parents[3] / "config" / "toy_nac.yaml"
Run = Callable[..., Result]


def doubled(number: int) -> int:
    return 2 * number


@pytest.mark.nightly
@pytest.mark.slow
def test_a_worker_with_other_code_is_rejected(monkeypatch: pytest.MonkeyPatch) -> None:
    distributed = pytest.importorskip("distributed")
    monkeypatch.setattr(provenance, "__version__", "9.9.9")
    with (
        distributed.LocalCluster(1, threads_per_worker=1, dashboard_address=None, silence_logs=50) as cluster,
        Workers(scheduler=cluster.scheduler_address).opened(1) as pool,
        pytest.raises(ValueError, match=r"worker: rkhs_ros: expected 9\.9\.9"),
    ):
        list(pool.results(doubled, [(1,)]))


@pytest.mark.slow
def test_workers_with_several_threads_are_rejected(rkhs: Run) -> None:
    distributed = pytest.importorskip("distributed")
    with distributed.LocalCluster(1, threads_per_worker=2, dashboard_address=None, silence_logs=50) as cluster:
        address = cluster.scheduler_address
        result = rkhs("sweep", CONFIG, "--vary", "algorithm.ridge=1,2", "--scheduler", address, "--out", "out")
    assert_refused(result, "--scheduler: expected workers of one thread (dask worker --nthreads 1), got 2 threads")


def test_a_single_process_executes_calls_in_sequence() -> None:
    taken: list[int] = []

    def arguments() -> Iterator[tuple[int]]:
        for number in (1, 2, 3):
            taken.append(number)
            yield (number,)

    with Workers(1).opened(3) as pool:
        made = pool.results(doubled, arguments())
        assert (next(made), taken) == (2, [1])
        assert list(made) == [4, 6]


def ended_by_signal(number: int) -> int:
    if number == 1:
        os.kill(os.getpid(), signal.SIGKILL)
    return number


@pytest.mark.slow
def test_killed_processes_are_reported_once_and_get_no_more_calls() -> None:
    with Workers(2).opened(2) as pool, pytest.raises(WorkerLostError, match="run the same command to continue"):
        list(pool.results(ended_by_signal, [(number,) for number in range(100)]))


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (
            ("--scheduler", "tcp://127.0.0.1:8786", "--jobs", "2"),
            "workers: expected either --jobs or --scheduler, got both",
        ),
        (("--scheduler", "127.0.0.1"), "--scheduler: expected an address such as tcp://HOST:8786, got '127.0.0.1'"),
        (("--scheduler", "tcp://127.0.0.1:1"), "--scheduler: expected a Dask scheduler at tcp://127.0.0.1:1, got none"),
    ],
)
def test_a_missing_dask_cluster_is_reported_in_one_line(
    rkhs: Run, options: tuple[str, ...], message: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("distributed")
    monkeypatch.setattr("rkhs_ros.studies.workers.CONNECT_TIMEOUT_S", 0.5)
    assert_refused(rkhs("train", CONFIG, "--seeds", "0-1", "--out", "many", *options), message)


def test_a_missing_extra_is_reported(rkhs: Run, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr("rkhs_ros.base.validation.find_spec", lambda name: None)
    expected = "expected distributed to be installed (pip install distributed, or the extra 'dask')"
    sweep = ("sweep", CONFIG, "--vary", "algorithm.ridge=1,2", "--scheduler", "tcp://127.0.0.1:8786")
    assert_refused(rkhs(*sweep), expected)
    assert list(tmp_path.iterdir()) == []
