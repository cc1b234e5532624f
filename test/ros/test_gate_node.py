"""The gate as a process: it commands a robot over real topics, within limits, and stops it whoever is killed."""

import os
import signal
import threading
import time
from collections.abc import Callable, Iterator
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest
import yaml
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import TwistStamped
from rcl_interfaces.srv import DescribeParameters
from sensor_msgs.msg import JointState
from std_msgs.msg import Bool, Float64MultiArray
from std_srvs.srv import Trigger
from trajectory_msgs.msg import JointTrajectory

from rkhs_interfaces.msg import Command, GateReport, GateState
from rkhs_ros.nodes.diagnostics import DIAGNOSTICS_QOS
from rkhs_ros.nodes.messages import LATCHED_QOS, LOCKSTEP_QOS
from test.ros.conftest import Probe, Process

TIMEOUT = 0.2
FLOATS, TRAJECTORY = "std_msgs/msg/Float64MultiArray", "trajectory_msgs/msg/JointTrajectory"
OUTPUTS = {FLOATS: Float64MultiArray, TRAJECTORY: JointTrajectory, "geometry_msgs/msg/TwistStamped": TwistStamped}
POSITION = {
    "joints": ["a"],
    "command": {"topic": "commands", "kind": "position"},
    "limits": {"minimum": [-1.0], "maximum": [1.0], "velocity": [2.0], "acceleration": [20.0]},
    "command_timeout": TIMEOUT,
    "stale_after": 0.5,
}
BASE = {
    "joints": ["linear.x", "angular.z"],
    "sensor": {"topic": ""},
    "command": {"topic": "cmd_vel", "type": "geometry_msgs/msg/TwistStamped", "kind": "velocity"},
    "limits": {"minimum": [-1.0, -1.0], "maximum": [1.0, 1.0], "acceleration": [5.0, 5.0]},
}


class Robot:
    """What the gate commands, in this process: it tells of its joint all the time, and keeps what it is sent.

    Owns a thread, as its joint is to be sensed while the test waits for other things.
    """

    def __init__(self, probe: Probe, output: str) -> None:
        self.position, self.is_sensed = 0.0, True
        self.sent: list[tuple[float, Any]] = []
        self.reports: list[GateReport] = []
        self.states: list[GateState] = []
        self.probe = probe
        probe.create_subscription(
            OUTPUTS[output], "cmd_vel" if "Twist" in output else "commands", self._obey, LOCKSTEP_QOS
        )
        probe.create_subscription(GateReport, "gate/report", self.reports.append, LOCKSTEP_QOS)
        probe.create_subscription(GateState, "gate/state", self.states.append, LATCHED_QOS)
        self.commands = probe.create_publisher(Command, "command", LOCKSTEP_QOS)
        self.stops = probe.create_publisher(Bool, "stop", LATCHED_QOS)
        self._joints = probe.create_publisher(JointState, "joint_states", 5)
        for name in ("arm", "stop"):
            probe.add_service(f"gate/{name}", Trigger)
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._tell, daemon=True)
        self._thread.start()

    def arm(self) -> str:
        """Ask until the gate is armed; return the last answer."""
        self.probe.until(lambda: self.commands.get_subscription_count() > 0 and bool(self.states))
        if self.is_sensed:
            self.probe.until(lambda: self._joints.get_subscription_count() > 0)
            self.probe.settle(0.1)
        return str(self.probe.ask("gate/arm", Trigger.Request()).message)

    def command(self, *values: float, number: int, instance: int = 7) -> GateReport:
        """Send a command and return what was reported of it."""
        stamp = self.probe.get_clock().now().to_msg()
        self.commands.publish(Command(instance=instance, number=number, stamp=stamp, values=values, hold=not values))
        self.probe.until(lambda: bool(self.reports) and self.reports[-1].number == number)
        return self.reports[-1]

    def until(self, state: str) -> GateState:
        self.probe.until(lambda: bool(self.states) and self.states[-1].state == state)
        return self.states[-1]

    def moved_last_at(self) -> float:
        """Return the time of the last output that differs from the one before."""
        pairs = pairwise(self.sent)
        return max(later[0] for earlier, later in pairs if earlier[1] != later[1])

    def close(self) -> None:
        self._ended.set()
        self._thread.join()

    def _obey(self, message: Any) -> None:
        self.sent.append((time.monotonic(), message))
        if isinstance(message, Float64MultiArray):
            self.position = message.data[0]

    def _tell(self) -> None:
        while not self._ended.wait(0.01):
            message = JointState(name=["other", "a"], position=[9.0, self.position])
            message.header.stamp = self.probe.get_clock().now().to_msg()
            if self.is_sensed:
                self._joints.publish(message)


@pytest.fixture
def begin(
    start: Callable[..., Process], probe: Probe, tmp_path: Path
) -> Iterator[Callable[..., tuple[Process, Robot]]]:
    robots = []

    def make(tree: dict[str, Any]) -> tuple[Process, Robot]:
        robots.append(Robot(probe, tree["command"].get("type", FLOATS)))
        return start("gate", "--ros-args", "--params-file", written(tmp_path, tree)), robots[-1]

    yield make
    for robot in robots:
        robot.close()


def written(folder: Path, tree: dict[str, Any]) -> Path:
    """Write a parameter file of a gate."""
    file = folder / "gate.yaml"
    file.write_text(yaml.safe_dump({"/**/gate": {"ros__parameters": tree}}))
    return file


def test_a_second_sender_is_refused_while_the_stream_of_the_first_is_on(
    begin: Callable[..., tuple[Process, Robot]],
) -> None:
    _, robot = begin(POSITION)
    robot.until("disarmed")
    assert robot.arm() == "holding"
    assert not robot.command(0.05, number=1).flags & GateReport.REFUSED
    assert robot.command(-0.5, number=2, instance=8).flags & GateReport.REFUSED
    assert robot.command(number=3, instance=8).flags & GateReport.REFUSED  # nor may it end the stream
    assert not robot.command(0.06, number=4).flags & GateReport.REFUSED
    assert not robot.command(number=5).flags & GateReport.REFUSED
    assert not robot.command(0.04, number=6, instance=8).flags & GateReport.REFUSED  # the first one holds now
    assert min(message.data[0] for _, message in robot.sent) > -0.1


def test_it_runs_dry_until_armed_then_passes_clamps_and_holds(begin: Callable[..., tuple[Process, Robot]]) -> None:
    gate, robot = begin(POSITION)
    robot.until("disarmed")
    robot.probe.until(lambda: robot.commands.get_subscription_count() > 0)
    robot.probe.settle(0.3)
    dry = robot.command(0.1, number=1)
    assert dry.flags & GateReport.NOT_ARMED
    assert not dry.flags & GateReport.REFUSED
    robot.command(number=2)
    assert not robot.sent
    assert robot.arm() == "holding"
    clamped = robot.command(3.0, number=3)
    assert clamped.flags & GateReport.CLAMPED_VALUE
    assert clamped.asked[0] == 3.0
    refused = robot.command(float("nan"), number=4)
    assert refused.flags == GateReport.REFUSED
    for number in range(5, 80):
        last = robot.command(0.1, number=number)
        robot.probe.settle(0.01)
    assert (last.flags, list(last.asked), list(last.executed)) == (0, [0.1], [0.1])
    assert robot.states[-1].state == "moving"
    robot.command(number=80)
    state = robot.until("holding")
    robot.probe.settle(2 * TIMEOUT)
    values = [message.data[0] for _, message in robot.sent]
    assert values[-1] == pytest.approx(0.1)
    assert max(abs(later - earlier) for earlier, later in pairwise(values)) <= 0.02 + 1e-9
    assert robot.states[-1] == state
    assert (state.refusals, state.stops, state.commands) == (1, 0, 80)
    heard: list[DiagnosticArray] = []
    robot.probe.create_subscription(DiagnosticArray, "/diagnostics", heard.append, DIAGNOSTICS_QOS)
    robot.probe.until(lambda: len(heard) > 1)
    told = {value.key: value.value for value in heard[-1].status[0].values}
    assert float(told["loop rate"]) > 50
    assert {"worst loop rate", "missed ticks", "clamps", "stops", "refusals"} <= set(told)
    gate.popen.terminate()
    assert gate.finish()[0] == 0


@pytest.mark.parametrize("number", [signal.SIGSTOP, pytest.param(signal.SIGKILL, marks=pytest.mark.faults)])
def test_commands_stop_when_their_sender_does(
    begin: Callable[..., tuple[Process, Robot]], start: Callable[..., Process], number: int
) -> None:
    _, robot = begin(POSITION)
    assert robot.arm() == "holding"
    first = start("sender", 0.9, 7)
    robot.probe.until(lambda: robot.position > 0.2)
    os.kill(first.popen.pid, number)
    killed_at = time.monotonic()
    state = robot.until("stopped")
    assert time.monotonic() - killed_at < TIMEOUT + 0.25  # what the probe takes to hear of it among the rest
    assert state.reason == "no command for 0.2 s"
    count = len(robot.sent)
    robot.probe.settle(0.5)
    assert len(robot.sent) > count + 20  # it holds, and does not fall silent
    assert robot.moved_last_at() - killed_at < TIMEOUT + 0.35
    again = start("sender", -0.9, 8)
    robot.probe.until(lambda: bool(robot.reports) and robot.reports[-1].instance == 8)
    robot.probe.settle(0.3)
    assert robot.states[-1].state == "stopped"
    assert robot.moved_last_at() - killed_at < TIMEOUT + 0.35
    assert robot.reports[-1].flags & GateReport.NOT_ARMED
    assert robot.arm() in ("holding", "moving")
    robot.probe.until(lambda: robot.position < -0.2)
    again.popen.terminate()


def test_a_stop_that_is_asked_for_holds_until_a_person_arms_it_after_it(
    begin: Callable[..., tuple[Process, Robot]], start: Callable[..., Process]
) -> None:
    _, robot = begin(POSITION)
    robot.stops.publish(Bool(data=False))
    robot.arm()
    start("sender", 0.9, 7)
    robot.until("moving")
    robot.stops.publish(Bool(data=True))
    assert "topic 'stop'" in robot.until("stopped").reason
    assert "expected nobody to ask for a stop" in robot.arm()
    robot.stops.publish(Bool(data=False))
    robot.probe.settle(0.2)
    assert robot.states[-1].state == "stopped"
    robot.probe.ask("gate/arm", Trigger.Request())
    robot.until("moving")
    robot.probe.ask("gate/stop", Trigger.Request())
    assert "service 'stop'" in robot.until("stopped").reason
    robot.probe.ask("gate/arm", Trigger.Request())
    robot.until("moving")
    robot.is_sensed = False
    assert "nothing was sensed" in robot.until("stopped").reason
    assert "nothing was sensed" in robot.arm()


def test_a_gate_that_is_told_to_end_stops_the_robot_first(
    begin: Callable[..., tuple[Process, Robot]], start: Callable[..., Process]
) -> None:
    slow = POSITION | {"limits": POSITION["limits"] | {"acceleration": [4.0]}, "command_timeout": 0.5}
    gate, robot = begin(slow | {"command": {"topic": "commands", "kind": "position", "type": TRAJECTORY}})
    assert robot.arm() == "holding"
    start("sender", 0.9, 7)
    robot.probe.until(lambda: bool(robot.sent) and robot.sent[-1][1].points[0].positions[0] > 0.2)
    points = robot.sent[-1][1].points  # which end in rest, should no further message come
    assert 2 < len(points) <= 10
    assert robot.sent[-1][1].joint_names == ["a"]
    seconds = [point.time_from_start.sec + 1e-9 * point.time_from_start.nanosec for point in points]
    speeds = [
        (later.positions[0] - earlier.positions[0]) / (end - begun)
        for earlier, later, begun, end in zip(points, points[1:], seconds, seconds[1:], strict=False)
    ]
    assert speeds == sorted(speeds, reverse=True)
    assert 0 <= speeds[-1] < 0.3
    gate.popen.terminate()
    robot.probe.until(lambda: gate.popen.poll() is not None)
    robot.probe.settle(0.1)
    assert gate.finish()[0] == 0
    assert "told to end" in robot.states[-1].reason
    assert len(robot.sent[-1][1].points) == 1  # at rest
    values = [message.points[0].positions[0] for _, message in robot.sent]
    speeds = [(later - earlier) / 0.01 for earlier, later in pairwise(values)]
    changes = [abs(later - earlier) / 0.01 for earlier, later in pairwise(speeds)]
    assert max(changes) <= 4.0 + 1e-6


def test_a_base_is_given_twists(begin: Callable[..., tuple[Process, Robot]], probe: Probe) -> None:
    _, robot = begin(BASE)
    robot.is_sensed = False
    assert robot.arm() == "holding"
    for number in range(40):
        robot.command(0.2, -0.3, number=number)
        robot.probe.settle(0.01)
    twist = robot.sent[-1][1]
    assert (twist.twist.linear.x, twist.twist.angular.z, twist.header.frame_id) == (0.2, -0.3, "base_link")
    assert twist.header.stamp.sec > 0
    probe.add_service("gate/describe_parameters", DescribeParameters)
    names = ["limits.acceleration", "command_timeout", "command.type"]
    limits, timeout, kind = probe.ask("gate/describe_parameters", DescribeParameters.Request(names=names)).descriptors
    assert all(each.description and each.read_only for each in (limits, timeout, kind))
    assert limits.floating_point_range[0].from_value == 0.0
    assert "std_msgs/msg/Float64MultiArray" in kind.additional_constraints


def test_a_robot_that_another_publisher_commands_is_not_armed(begin: Callable[..., tuple[Process, Robot]]) -> None:
    _, robot = begin(POSITION)
    robot.probe.create_publisher(Float64MultiArray, "commands", 1)
    robot.probe.settle(0.5)
    assert "expected no other publisher, got /commands: /gate, /probe (unknown)" in robot.arm()
    assert robot.states[-1].state == "disarmed"


@pytest.mark.parametrize(
    ("tree", "message"),
    [
        ({}, "joints: expected the names of the joints, got none"),
        ({**POSITION, "limits": {"minimum": [-1.0]}}, "limits.maximum: expected a limit"),
        ({**POSITION, "limit": 1}, "unknown key 'limit', did you mean 'limits'?"),
    ],
)
def test_bad_parameters_are_refused_in_one_line(
    start: Callable[..., Process], tmp_path: Path, tree: dict[str, Any], message: str
) -> None:
    gate = start("gate", "--ros-args", "--params-file", written(tmp_path, tree))
    code, out, err = gate.finish()
    assert (code, out) == (2, "")
    assert err.count("\n") == 1
    assert message in err
