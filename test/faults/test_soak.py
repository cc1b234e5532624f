"""A long run leaks neither memory nor files."""

import time
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import pytest

from test.faults.runs import curve
from test.faults.test_kills import NODES
from test.ros.conftest import ROOT, Process, nodes_of

ITERATIONS, SETTLED = 3000, 300
GROWTH = 1.05


class Footprint(NamedTuple):
    """The resources of a process."""

    resident: int  # bytes
    threads: int
    files: int


def footprint(pid: int) -> Footprint:
    status = dict(line.split(":", 1) for line in Path(f"/proc/{pid}/status").read_text().splitlines())
    resident, threads = int(status["VmRSS"].split()[0]) * 1024, int(status["Threads"])
    return Footprint(resident, threads, len(list(Path(f"/proc/{pid}/fd").iterdir())))


def shared_memory() -> set[Path]:
    return set(Path("/dev/shm").glob("*fast*"))


@pytest.mark.timeout(900)
def test_a_long_run_neither_grows_nor_leaves_anything_behind(start: Callable[..., Process], tmp_path: Path) -> None:
    before = shared_memory()
    folder = tmp_path / "run"
    options = ("--quiet", "--iterations", ITERATIONS, "--out", folder)
    run = start("rkhs", "train", ROOT / "config" / "toy_nac.yaml", *options)
    footprints: dict[str, list[Footprint]] = {name: [] for name in NODES}
    nodes: dict[str, int] = {}
    for iterations in (SETTLED, ITERATIONS - 20):
        while len(curve(folder)) <= iterations:
            assert run.popen.poll() is None
            time.sleep(0.02 if iterations < SETTLED else 0.2)
        nodes = {name: nodes_of(run, name)[0] for name in NODES}
        for name, pid in nodes.items():
            footprints[name].append(footprint(pid))
    code, _, err = run.finish()
    assert (code, err) == (0, "")
    for name, (first, last) in footprints.items():
        print(f"{name}: {first} after {SETTLED} iterations, {last} after {ITERATIONS - 20}")
        assert last.resident < GROWTH * first.resident
        assert last.threads <= first.threads
        assert last.files <= first.files
    assert not [pid for pid in nodes.values() if Path(f"/proc/{pid}").exists()]
    assert shared_memory() <= before
