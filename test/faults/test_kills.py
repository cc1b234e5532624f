"""Killing nodes at any time leaves the learning curve and the policy bit-identical."""

import time
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import pytest

from test.faults.conftest import PENDULUM
from test.faults.runs import assert_same_bits, curve
from test.processes import of_process
from test.ros.conftest import Process, kill, nodes_of

Start = Callable[..., Process]
MOST_KILLS = 5  # of a run, all of which may be within five minutes
NODES = ("simulator", "policy", "learner")


def wait_for(condition: Callable[[], bool], run: Process) -> None:
    deadline = time.monotonic() + 100
    while run.popen.poll() is None and not condition():
        assert time.monotonic() < deadline, "the run does not go on"
        time.sleep(0.01)


def shared_memory(pid: int) -> list[str]:
    """Return the shared-memory files of DDS that a process has opened."""
    return [line for line in of_process(pid, "maps").splitlines() if "/dev/shm/fastrtps_" in line]


def kill_at_random(
    run: Process, folder: Path, draws: np.random.Generator, kills: int, order: Sequence[str]
) -> list[str]:
    """Kill nodes of a run in this order at random times, during training and while the run resumes."""
    done: list[str] = []
    while len(done) < kills and run.popen.poll() is None:
        if draws.random() < 0.7:
            goal = len(curve(folder)) + draws.integers(1, 4)
            wait_for(lambda: len(curve(folder)) >= goal, run)  # noqa: B023  # awaited here
        time.sleep(draws.uniform(0, 0.3))
        name = order[len(done)]
        victims = nodes_of(run, name)
        if victims:
            victim = int(draws.choice(victims))
            assert not shared_memory(victim)  # no process would free it
            kill(victim)
            done.append(f"{name} after iteration {max(len(curve(folder)) - 1, 0)}")
    return done


@pytest.mark.ci
@pytest.mark.timeout(300)
def test_a_killed_node_of_each_kind_leaves_the_results_bit_identical(
    start: Start, tmp_path: Path, undisturbed: Path
) -> None:
    folder = tmp_path / "killed"
    run = start("rkhs", "train", PENDULUM, "--quiet", "--out", folder, "--set", "timeout=60")
    done = kill_at_random(run, folder, np.random.default_rng(5), len(NODES), NODES)
    code, _, err = run.finish()
    assert (code, [name.split()[0] for name in done]) == (0, list(NODES)), err
    told = [
        line
        for count, name in enumerate(NODES, 1)
        for line in (f"error: the {name} node", f"({count} of at most {MOST_KILLS} times within 300 s)")
    ]
    assert all(words in line for words, line in zip(told, err.splitlines(), strict=True)), err
    assert_same_bits(folder, undisturbed)


@pytest.mark.timeout(600)
def test_killed_nodes_leave_the_results_bit_identical(
    start: Start, tmp_path: Path, undisturbed: Path, kills: int
) -> None:
    for number in range(-(-kills // MOST_KILLS)):
        folder, draws = tmp_path / f"killed_{number}", np.random.default_rng([number, len(NODES)])
        run = start("rkhs", "train", PENDULUM, "--quiet", "--out", folder, "--set", "timeout=60")
        done = kill_at_random(run, folder, draws, MOST_KILLS, draws.choice(NODES, MOST_KILLS).tolist())
        code, _, err = run.finish()
        print(f"run {number}, {len(done)} kills: {'; '.join(done)}")
        assert (code, len(done)) == (0, MOST_KILLS), err
        assert "Traceback" not in err
        assert_same_bits(folder, undisturbed)


@pytest.mark.ci
@pytest.mark.timeout(300)
def test_the_nodes_of_a_killed_launcher_exit_and_the_run_can_be_resumed(
    start: Start, tmp_path: Path, undisturbed: Path
) -> None:
    folder = tmp_path / "run"
    run = start("rkhs", "train", PENDULUM, "--quiet", "--out", folder)
    wait_for(lambda: len(curve(folder)) > 5, run)
    nodes = [pid for name in NODES for pid in nodes_of(run, name)]
    run.popen.kill()
    deadline = time.monotonic() + 30
    while any(Path(f"/proc/{pid}").exists() for pid in nodes):
        assert time.monotonic() < deadline, "nodes outlive their launcher"
        time.sleep(0.05)
    assert len(curve(folder)) < len(curve(undisturbed))
    code, _, err = start("rkhs", "train", "--quiet", "--resume", folder).finish()
    assert (code, err) == (0, "")
    assert_same_bits(folder, undisturbed)
