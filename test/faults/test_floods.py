"""Floods of messages and huge messages from a foreign node do not change the results of a run."""

import re
import time
from array import array
from collections.abc import Callable
from pathlib import Path

import pytest

from rkhs_interfaces.msg import Action, Episodes, Observation
from test.faults.conftest import PENDULUM
from test.faults.runs import assert_same_bits
from test.processes import of_process
from test.ros.conftest import Probe, Process, nodes_of, probe

__all__ = ["probe"]
Start = Callable[..., Process]
NODES = ("simulator", "policy", "learner")
FLOOD_S = 5.0
LEAST_SENT = 10_000
HUGE = 100_000_000  # bytes of an array
GROWTH = 700e6  # bytes: the middleware stores the message, and a copy during the callback


@pytest.fixture
def run(start: Start, tmp_path: Path, probe: Probe) -> Process:
    """Start a run over topics."""
    begun = start("rkhs", "train", PENDULUM, "--quiet", "--out", tmp_path / "run")
    probe.until(lambda: len(probe.heard["episodes"]) > 2)
    return begun


def assert_unharmed(run: Process, folder: Path, undisturbed: Path) -> None:
    code, _, err = run.finish()
    assert code == 0, err
    assert "killed" not in err
    assert_same_bits(folder, undisturbed)


def test_a_flood_of_messages_leaves_the_results_bit_identical(
    run: Process, probe: Probe, tmp_path: Path, undisturbed: Path
) -> None:
    flood = {"action": Action(), "observation": Observation(num_envs=1, horizon=10), "episodes": Episodes()}
    for topic, message in flood.items():
        probe.say(topic, message)
    sent, end = 0, time.monotonic() + FLOOD_S
    while time.monotonic() < end:
        for topic, message in flood.items():
            probe.say(topic, message)
            sent += 1
    assert sent > LEAST_SENT
    assert_unharmed(run, tmp_path / "run", undisturbed)


def test_huge_messages_leave_the_results_bit_identical_and_use_only_memory_of_the_middleware(
    run: Process, probe: Probe, tmp_path: Path, undisturbed: Path
) -> None:
    pids = {name: nodes_of(run, name)[0] for name in NODES}
    before = {name: peak_memory(pid) for name, pid in pids.items()}
    zeros = array("d", bytes(HUGE))
    probe.say("action", Action(actions=zeros))
    probe.say("observation", Observation(num_envs=1, horizon=10, observations=zeros))
    probe.say("episodes", Episodes(observations=zeros))
    probe.settle(2.0)
    after = {name: peak_memory(pid) for name, pid in pids.items()}
    print({name: after[name] - before[name] for name in NODES})
    assert all(0 < after[name] - before[name] < GROWTH for name in NODES)
    assert_unharmed(run, tmp_path / "run", undisturbed)


def peak_memory(pid: int) -> float:
    """Return the peak memory of a process in bytes; 0 if it has exited."""
    found = re.search(r"^VmHWM:\s*(\d+) kB", of_process(pid, "status"), re.MULTILINE)
    return 1024 * float(found[1]) if found else 0.0
