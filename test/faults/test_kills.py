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
RUNS = 4  # runs among which the kills are divided
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
    run: Process, folder: Path, draws: np.random.Generator, kills: int, order: Sequence[str] = ()
) -> list[str]:
    """Kill nodes of a run at random times, during training and during the recovery from the last kill.

    The nodes are killed in the given order, or drawn from all.
    """
    done: list[str] = []
    while len(done) < kills and run.popen.poll() is None:
        if draws.random() < 0.7:
            goal = len(curve(folder)) + draws.integers(1, 4)
            wait_for(lambda: len(curve(folder)) >= goal, run)  # noqa: B023  # awaited here
        time.sleep(draws.uniform(0, 0.3))
        name = order[len(done) % len(order)] if order else str(draws.choice(NODES))
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
    run = start("rkhs", "train", PENDULUM, "--quiet", "--simulators", 2, "--out", folder, "--set", "timeout=60")
    done = kill_at_random(run, folder, np.random.default_rng(5), len(NODES), NODES)
    code, _, err = run.finish()
    assert (code, [name.split()[0] for name in done]) == (0, list(NODES)), err
    assert "Traceback" not in err
    assert_same_bits(folder, undisturbed)


@pytest.mark.timeout(600)
@pytest.mark.parametrize("simulators", [1, 2])
@pytest.mark.parametrize("seed", range(RUNS // 2))
def test_killed_nodes_leave_the_results_bit_identical(
    start: Start, tmp_path: Path, undisturbed: Path, kills: int, seed: int, simulators: int
) -> None:
    share = -(-kills // RUNS)
    folder = tmp_path / "killed"
    run = start(
        "rkhs", "train", PENDULUM, "--quiet", "--simulators", simulators, "--out", folder, "--set", "timeout=60"
    )
    done = kill_at_random(run, folder, np.random.default_rng([seed, simulators]), share)
    code, _, err = run.finish()
    print(f"seed {seed}, {simulators} simulators, {len(done)} kills: {'; '.join(done)}")
    assert (code, len(done)) == (0, share), err
    assert "Traceback" not in err
    assert_same_bits(folder, undisturbed)


@pytest.mark.timeout(600)
def test_killing_simulator_and_policy_node_together_leaves_the_results_bit_identical(
    start: Start, tmp_path: Path, undisturbed: Path, kills: int
) -> None:
    share, folder = -(-kills // RUNS), tmp_path / "killed"
    run = start("rkhs", "train", PENDULUM, "--quiet", "--runner", "composed", "--out", folder, "--set", "timeout=60")
    done = kill_at_random(run, folder, np.random.default_rng(2), share, ("composed", "learner"))
    code, _, err = run.finish()
    assert (code, len(done)) == (0, share), err
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


@pytest.mark.timeout(300)
def test_a_node_that_dies_too_often_ends_the_run(start: Start, tmp_path: Path) -> None:
    run = start("rkhs", "train", PENDULUM, "--quiet", "--out", tmp_path / "run", "--set", "timeout=120")
    while run.popen.poll() is None:
        for pid in nodes_of(run, "policy"):
            kill(pid)
        time.sleep(0.02)
    code, _, err = run.finish()
    assert code == 1
    assert err.splitlines()[-1] == "error: the policy node died more than 10 times within 300 s"
