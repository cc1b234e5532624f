"""Lost, duplicated and delayed observations and actions slow a run down, but leave it bit-identical."""

import signal
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from test.faults.runs import assert_same_bits
from test.ros.conftest import Process

Start = Callable[..., Process]
SENT = ("-r", "observation:=observation_sent")
HEARD = ("-r", "action:=action_sent")


def learn_through_a_relay(
    start: Start, parameters: Callable[..., Path], folder: Path, share: float
) -> tuple[float, str]:
    """Run the pendulum with a relay between simulator and policy node; return the seconds and its output."""
    file = parameters("pendulum_nac")
    relay = start("relay", "--share", share)
    nodes = [
        start("simulator", "--ros-args", "--params-file", file, *SENT),
        start("policy", "--ros-args", *HEARD),
    ]
    begin = time.monotonic()
    learner = start("learner", "--ros-args", "--params-file", file, "-p", f"output:={folder}", "-p", "quiet:=true")
    learner.popen.wait(500)
    seconds = time.monotonic() - begin
    for process in (relay, *nodes):
        process.popen.send_signal(signal.SIGTERM)
    assert learner.finish() == (0, "", "")
    assert [node.finish()[0] for node in nodes] == [0, 0]
    return seconds, relay.finish()[1].strip()


@pytest.mark.timeout(600)
def test_lost_duplicated_and_delayed_messages_leave_the_results_bit_identical(
    start: Start, parameters: Callable[..., Path], tmp_path: Path, undisturbed: Path
) -> None:
    good, _ = learn_through_a_relay(start, parameters, tmp_path / "good", 0.0)
    bad, fates = learn_through_a_relay(start, parameters, tmp_path / "bad", 0.05)
    print(f"{fates}: {bad:.1f} s in place of {good:.1f} s")
    for folder in ("good", "bad"):
        assert_same_bits(tmp_path / folder, undisturbed)
    assert all(int(count.split()[0]) > 400 for count in fates.split(", "))
