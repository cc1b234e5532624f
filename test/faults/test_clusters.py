"""A study on a cluster whose worker is killed has the same tables as one on a single core."""

import os
import signal
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from threading import Thread
from typing import Any

import pytest

from test.ros.conftest import ROOT
from test.unit.conftest import Result, rkhs

__all__ = ["rkhs"]
pytestmark = pytest.mark.slow
CONFIG = ROOT / "config" / "toy_nac.yaml"
TINY = ("horizon=4", "iterations=3", "episodes_per_iteration=2", "evaluation_episodes=2")
TWENTY = ("--vary", "algorithm.ridge=1e-3,1e-2", "kernel.bandwidth_scale=1,2", "--seeds", "0-4", "--quiet")
Run = Callable[..., Result]


@pytest.fixture
def dask() -> Iterator[Any]:
    """Start a Dask cluster of two single-threaded workers with nannies that restart them."""
    distributed = pytest.importorskip("distributed")
    with distributed.LocalCluster(2, threads_per_worker=1, dashboard_address=None, silence_logs=50) as cluster:
        yield cluster


def tables(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in sorted(folder.glob("*.csv"))}


def test_a_killed_dask_worker_does_not_change_twenty_runs(rkhs: Run, dask: Any, tmp_path: Path) -> None:
    on = ("--jobs", dask.scheduler_address)

    def kill() -> None:
        while len(list(tmp_path.glob("dask/runs/*/policy.npz"))) < 5:
            time.sleep(0.02)
        os.kill(next(iter(dask.workers.values())).pid, signal.SIGKILL)

    killed = Thread(target=kill, daemon=True)
    killed.start()
    assert rkhs("sweep", CONFIG, *TWENTY, "--set", *TINY, "--out", "dask", *on).code == 0
    killed.join(1.0)
    assert not killed.is_alive()
    assert rkhs("sweep", CONFIG, *TWENTY, "--set", *TINY, "--out", "alone", "--jobs", 1).code == 0
    assert len(list((tmp_path / "dask" / "runs").iterdir())) == 20
    assert tables(tmp_path / "dask") == tables(tmp_path / "alone")
    assert (tmp_path / "dask" / "runs.csv").read_text().count("\n") == 21
