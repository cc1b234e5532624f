"""Simulators on other machines, simulated by network namespaces; one is disconnected, temporarily and for good."""

import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from rkhs_ros.app.launcher import for_all
from rkhs_ros.nodes.core.transport import PROFILES, RANGE
from rkhs_ros.runs.config import load_config
from rkhs_ros.runs.report import resolved
from test.faults.conftest import PENDULUM
from test.faults.runs import assert_same_bits, curve
from test.ros.conftest import MODULES

pytestmark = [pytest.mark.ros, pytest.mark.slow, pytest.mark.timeout(300)]
HOME, *OTHERS = (f"rkhs{os.getpid()}{name}" for name in "hab")  # namespaces of the learner and of each simulator


def ip(*words: str) -> str:
    """Configure the network, or skip the test without permission; return the output."""
    try:
        return subprocess.run(["ip", *words], check=True, capture_output=True, text=True).stdout
    except FileNotFoundError:
        pytest.skip("expected the command ip, of iproute2, got none")
    except subprocess.CalledProcessError as error:
        pytest.skip(f"expected the right to make network namespaces, got {error.stderr.strip()}")


@pytest.fixture
def machines() -> Iterator[None]:
    """Create three network namespaces: one with a virtual cable to each of the two others."""
    made = []
    try:
        for name in (HOME, *OTHERS):
            ip("netns", "add", name)
            made.append(name)
            ip("-n", name, "link", "set", "lo", "up")
        for k, name in enumerate(OTHERS):
            cable, end = f"cable{k}", ("peer", "name", "cable", "netns", name)
            ip("-n", HOME, "link", "add", cable, "type", "veth", *end)
            for place, link, host in ((HOME, cable, 1), (name, "cable", 2)):
                ip("-n", place, "address", "add", f"10.77.{k}.{host}/24", "dev", link)
                ip("-n", place, "link", "set", link, "up")
        wait_until_plugged_in()
        yield
    finally:
        for name in made:
            subprocess.run(["ip", "netns", "delete", name], check=False, capture_output=True)


def wait_until_plugged_in() -> None:
    """Wait until the cables are up, which may take a second; nodes use only interfaces that are up when they start."""
    ends = [(HOME, "cable0"), (HOME, "cable1"), *((name, "cable") for name in OTHERS)]
    deadline = time.monotonic() + 20
    while not all("state UP" in ip("-n", place, "link", "show", link) for place, link in ends):
        assert time.monotonic() < deadline, "a cable does not carry"
        time.sleep(0.02)


Start = Callable[..., subprocess.Popen[str]]


@pytest.fixture
def start_in(machines: None, domain: int, tmp_path: Path) -> Iterator[Start]:
    """Start nodes in the namespaces, with their output in files; they end with the test."""
    file = tmp_path / "parameters.yaml"
    file.write_text(for_all(resolved(load_config(PENDULUM, ["simulators=2", "timeout=30"])), 2))
    environment = {k: v for k, v in os.environ.items() if k not in (PROFILES[0], "_ROS_WHEELS_BOOTSTRAP_COMPLETE")}
    environment[RANGE] = "SUBNET"
    processes: list[subprocess.Popen[str]] = []

    def begin(place: str, node: str, namespace: str = "/", *parameters: str) -> subprocess.Popen[str]:
        words = ["--ros-args", "-r", f"__ns:={namespace}", "--params-file", str(file), *parameters]
        command = ["ip", "netns", "exec", place, sys.executable, "-m", MODULES[node], *words]
        with (tmp_path / f"{node}.txt").open("a") as said:
            processes.append(subprocess.Popen(command, stdout=said, stderr=said, env=environment, text=True))
        return processes[-1]

    yield begin
    for process in processes:
        process.kill()
        process.wait()


def wait_for(condition: Callable[[], bool], learner: subprocess.Popen[str]) -> None:
    deadline = time.monotonic() + 120
    while not condition():
        assert learner.poll() is None, "the learner has ended"
        assert time.monotonic() < deadline, "nothing came in time"
        time.sleep(0.05)


@pytest.mark.parametrize("cut", ["never", "for 10 s", "for good"])
def test_a_run_with_a_disconnected_remote_simulator_is_bit_identical_to_one_machine(
    start_in: Start, undisturbed: Path, tmp_path: Path, cut: str
) -> None:
    folder, said = tmp_path / "run", tmp_path / "learner.txt"
    learner = start_in(HOME, "learner", "/", "-p", f"output:={folder}", "-p", "quiet:=true")
    start_in(HOME, "policy")
    start_in(OTHERS[0], "simulator", "/simulator_1")
    wait_for(lambda: "waiting for the simulator_2/simulator node" in said.read_text(), learner)
    start_in(OTHERS[1], "simulator", "/simulator_2")
    if cut != "never":
        wait_for(lambda: len(curve(folder)) > 5, learner)
        ip("-n", HOME, "link", "set", "cable1", "down")
    if cut == "for 10 s":
        time.sleep(10)
        ip("-n", HOME, "link", "set", "cable1", "up")
    assert learner.wait(200) == 0
    assert_same_bits(folder, undisturbed)
    lost = "the simulator_2/simulator node did not answer within 30 s"
    assert (lost in said.read_text()) == (cut == "for good")
