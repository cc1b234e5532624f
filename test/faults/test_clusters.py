"""A study on a cluster whose worker is killed has the same tables as one on a single core."""

import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path
from threading import Thread
from typing import Any

import pytest

from rkhs_ros.studies.workers import WorkerLostError, Workers
from test.ros.conftest import ROOT
from test.unit.conftest import Result, rkhs

__all__ = ["rkhs"]
pytestmark = pytest.mark.slow
CONFIG = ROOT / "config" / "toy_nac.yaml"
TINY = ("horizon=4", "iterations=3", "episodes_per_iteration=2", "evaluation_episodes=2")
FORTY = ("--vary", "algorithm.ridge=1e-3,1e-2", "kernel.bandwidth_scale=1,2", "--seeds", "0-9", "--quiet")
Run = Callable[..., Result]


@pytest.fixture
def dask() -> Iterator[Any]:
    """Start a Dask cluster of two single-threaded workers with nannies that restart them."""
    distributed = pytest.importorskip("distributed")
    with distributed.LocalCluster(2, threads_per_worker=1, dashboard_address=None, silence_logs=50) as cluster:
        yield cluster


@pytest.fixture
def ray(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """Start a Ray cluster of two cores and return its address."""
    pytest.importorskip("ray")
    home, port = tmp_path_factory.mktemp("r"), 20_000 + os.getpid() % 10_000
    command = [sys.executable, "-c", "from ray.scripts.scripts import main; main()", "start", "--head", "--block"]
    options = ["--num-cpus=2", f"--port={port}", "--include-dashboard=false", "--disable-usage-stats"]
    streams = {"stdin": subprocess.DEVNULL, "stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    head = subprocess.Popen([*command, *options, f"--temp-dir={home}"], **streams)
    try:
        _wait_for(port, head)
        yield f"127.0.0.1:{port}"
    finally:
        head.terminate()  # ends its own processes only, not those of other Ray clusters
        head.wait(30)


def _wait_for(port: int, head: subprocess.Popen[bytes]) -> None:
    deadline = time.monotonic() + 60
    while head.poll() is None and time.monotonic() < deadline:
        with suppress(OSError), socket.create_connection(("127.0.0.1", port), 1):
            return
        time.sleep(0.1)
    raise TimeoutError("expected a Ray cluster, got none")


def tables(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in sorted(folder.glob("*.csv"))}


def kill_when(folder: Path, runs: int, victims: Callable[[], list[int]]) -> Thread:
    """Kill one of the processes after a number of runs."""

    def kill() -> None:
        while len(list(folder.glob("runs/*/episodes.npz"))) < runs or not (found := victims()):
            time.sleep(0.02)
        os.kill(found[0], signal.SIGKILL)

    thread = Thread(target=kill, daemon=True)
    thread.start()
    return thread


def of_ray() -> list[int]:
    """Return the Ray processes that execute a call."""
    commands = {int(path.parent.name): path for path in Path("/proc").glob("[0-9]*/cmdline")}
    found = []
    for pid, path in commands.items():
        try:
            found += [pid] * path.read_bytes().startswith(b"ray::_checked")
        except OSError:  # the process has exited
            continue
    return found


def test_a_killed_dask_worker_does_not_change_forty_runs(rkhs: Run, dask: Any, tmp_path: Path) -> None:
    on = ("--scheduler", dask.scheduler_address)
    killed = kill_when(tmp_path / "dask", 5, lambda: [next(iter(dask.workers.values())).pid])
    assert rkhs("sweep", CONFIG, *FORTY, "--set", *TINY, "--out", "dask", *on).code == 0
    killed.join(1.0)
    assert not killed.is_alive()
    assert rkhs("sweep", CONFIG, *FORTY, "--set", *TINY, "--out", "alone", "--jobs", 1).code == 0
    assert len(list((tmp_path / "dask" / "runs").iterdir())) == 40
    assert tables(tmp_path / "dask") == tables(tmp_path / "alone")
    assert (tmp_path / "dask" / "runs.csv").read_text().count("\n") == 41


def test_a_killed_ray_worker_does_not_change_forty_runs(rkhs: Run, ray: str, tmp_path: Path) -> None:
    killed = kill_when(tmp_path / "ray", 5, of_ray)
    assert rkhs("sweep", CONFIG, *FORTY, "--set", *TINY, "--out", "ray", "--ray", ray).code == 0
    killed.join(1.0)
    assert not killed.is_alive()
    assert rkhs("sweep", CONFIG, *FORTY, "--set", *TINY, "--out", "alone", "--jobs", 1).code == 0
    assert tables(tmp_path / "ray") == tables(tmp_path / "alone")


def ends_its_process(number: int) -> int:
    if number == 1:
        os.kill(os.getpid(), signal.SIGKILL)
    return number


def test_calls_that_kill_every_worker_are_reported_after_the_others(dask: Any) -> None:
    with Workers(scheduler=dask.scheduler_address).opened(3) as pool:
        made = pool.results(ends_its_process, [(0,), (1,), (2,)])
        assert sorted([next(made), next(made)]) == [0, 2]
        with pytest.raises(WorkerLostError, match="run the same command to continue"):
            next(made)
