"""Whatever ends a gate, it first brings the robot to rest, since hardware may keep the newest command for ever.

The tests of the pure gate combine kinds of commands, moments of a motion and faults.
"""

import signal
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest
from std_msgs.msg import String

from test.ros.conftest import Process
from test.ros.gate_bench import CALM, begin, written

__all__ = ["begin"]
ACCELERATION, PERIOD, SPEED = 5.0, 0.01, 1.5
VELOCITY = CALM | {
    "command": {"topic": "commands", "kind": "velocity"},
    "limits": {"minimum": [-2.0], "maximum": [2.0], "acceleration": [ACCELERATION]},
}
Begin, Start = Callable[..., Any], Callable[..., Process]


@pytest.fixture
def moving(begin: Begin, start: Start) -> tuple[Process, Any]:
    """A gate that may fail, in a process of its own, and its robot in motion."""
    gate, robot = begin(VELOCITY, process="failing_gate")
    assert robot.arm() == "holding"
    start("sender", SPEED, 7)
    robot.probe.until(lambda: bool(robot.sent) and robot.sent[-1].message.data[0] == SPEED)
    return gate, robot


@pytest.mark.parametrize("how", ["SIGHUP", "SIGQUIT", "callback", "check", "executor"])
def test_a_gate_that_ends_brakes_first(moving: tuple[Process, Any], how: str) -> None:
    gate, robot = moving
    if how.startswith("SIG"):
        gate.popen.send_signal(signal.Signals[how])
    else:
        faults = robot.probe.create_publisher(String, "fail", 1)
        robot.probe.until(lambda: faults.get_subscription_count() > 0)
        faults.publish(String(data=how))
    robot.probe.until(lambda: gate.popen.poll() is not None)
    robot.probe.until(lambda: robot.sent[-1].message.data[0] == 0.0)
    assert (gate.finish()[0] == 0) == how.startswith("SIG")
    sent = [(each.number, each.message.data[0]) for each in robot.sent]
    steps = [abs(after - before) for (one, before), (two, after) in pairwise(sent) if two == one + 1]
    assert max(steps) <= ACCELERATION * PERIOD + 1e-9


def test_a_second_gate_exits_and_user_signals_are_ignored(
    moving: tuple[Process, Any], start: Start, tmp_path: Path
) -> None:
    gate, robot = moving
    code, _, err = start("gate", "--ros-args", "--params-file", written(tmp_path, VELOCITY)).finish()
    assert code == 1
    assert "error: expected one gate node, got another one that is already running" in err
    for number in (signal.SIGUSR1, signal.SIGUSR2, signal.SIGTSTP):
        gate.popen.send_signal(number)
    sent = len(robot.sent)
    robot.probe.until(lambda: len(robot.sent) > sent + 20)
    assert (gate.popen.poll(), robot.states[-1].state) == (None, "moving")
