"""The gate node: it commands a robot within limits, stops it whichever node is killed, and brakes before it ends."""

import os
import signal
import time
from collections.abc import Callable
from itertools import count, pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray
from rcl_interfaces.srv import DescribeParameters
from std_msgs.msg import Float64MultiArray, String
from std_srvs.srv import Trigger

from rkhs_interfaces.msg import GateReport
from rkhs_ros.nodes.core.diagnostics import DIAGNOSTICS_QOS
from rkhs_ros.nodes.core.messages import LATCHED_QOS
from test.ros.conftest import Process
from test.ros.gate_bench import BASE, CALM, POSITION, TIMEOUT, TRAJECTORY, Robot, begin, written

__all__ = ["begin"]
PERIOD = 0.01
Begin = Callable[..., Any]


def reports(robot: Robot) -> list[DiagnosticArray]:
    heard: list[DiagnosticArray] = []
    robot.probe.create_subscription(DiagnosticArray, "/diagnostics", heard.append, DIAGNOSTICS_QOS)
    return heard


def told(heard: list[DiagnosticArray]) -> dict[str, str]:
    return {value.key: value.value for value in heard[-1].status[0].values} if heard else {}


def is_refused(report: GateReport) -> bool:
    return bool(report.flags & GateReport.REFUSED)


def test_the_gate_dry_runs_until_armed_then_clamps_and_holds(begin: Begin) -> None:
    gate, robot = begin(POSITION, process="gate")
    robot.until("disarmed")
    robot.probe.until(lambda: robot.commands.get_subscription_count() > 0)
    dry = next(report for report in (robot.command(0.1, number=n) for n in count(1)) if not is_refused(report))
    numbers = count(dry.number + 1)  # those before were refused, as nothing was sensed yet
    assert dry.flags & GateReport.NOT_ARMED
    robot.command(number=next(numbers))
    assert not robot.sent
    assert robot.arm() == "holding"
    clamped = robot.command(3.0, number=next(numbers))
    assert (clamped.asked[0], clamped.flags & GateReport.CLAMPED_VALUE) == (3.0, GateReport.CLAMPED_VALUE)
    assert robot.command(float("nan"), number=next(numbers)).flags == GateReport.REFUSED
    robot.probe.until(lambda: list(robot.command(0.1, number=next(numbers)).executed) == [0.1])
    assert robot.states[-1].state == "moving"
    robot.command(number=next(numbers))
    state = robot.until("holding")
    assert (state.refusals, state.stops) == (dry.number, 0)
    sent = {each.number: each.message.data[0] for each in robot.sent}
    assert all(abs(sent[n + 1] - sent[n]) <= 0.02 + 1e-9 for n in sent if n + 1 in sent)
    heard = reports(robot)
    robot.probe.until(lambda: {"worst loop rate", "missed ticks", "clamps", "stops"} <= set(told(heard)))
    gate.popen.terminate()
    assert gate.finish()[0] == 0


@pytest.mark.parametrize("number", [signal.SIGSTOP, pytest.param(signal.SIGKILL, marks=pytest.mark.nightly)])
def test_the_robot_stops_when_the_sender_stops(begin: Begin, start: Any, number: int) -> None:
    robot = begin(POSITION | {"limits": POSITION["limits"] | {"velocity": [0.4]}})  # it does not arrive before
    assert robot.arm() == "holding"
    first = start("sender", 0.9, 7)
    robot.probe.until(lambda: robot.position > 0.2)
    os.kill(first.popen.pid, number)
    assert robot.until("stopped").reason == f"no command for {TIMEOUT:g} s"
    sent = len(robot.sent)
    robot.probe.until(lambda: len(robot.sent) > sent + 50)  # it holds, and does not fall silent
    taken = robot.reports[-1].stamp
    after = [each.number for each in robot.sent if each.sent_ns > 10**9 * taken.sec + taken.nanosec]
    stopped_at = robot.moved_last()
    # By its own clock: outputs are a period apart at least, however busy the machine is. It brakes within 0.02 s.
    assert stopped_at - after[0] <= (TIMEOUT + 0.02) / PERIOD + 2
    start("sender", -0.9, 8)
    robot.probe.until(lambda: bool(robot.reports) and robot.reports[-1].instance == 8)
    assert robot.reports[-1].flags & GateReport.NOT_ARMED
    assert robot.states[-1].state == "stopped"
    assert robot.moved_last() == stopped_at
    assert robot.arm() in ("holding", "moving")
    robot.probe.until(lambda: robot.position < -0.2)


def test_a_stop_by_the_service_and_a_silent_sensor_hold_until_the_gate_is_armed(begin: Begin, start: Any) -> None:
    robot = begin(POSITION)
    robot.arm()
    start("sender", 0.9, 7)
    robot.until("moving")
    robot.probe.ask("gate/stop", Trigger.Request())
    assert "service 'stop'" in robot.until("stopped").reason
    robot.probe.ask("gate/arm", Trigger.Request())
    robot.until("moving")
    robot.is_sensed = False
    assert "no usable joint state" in robot.until("stopped").reason
    assert "no usable joint state" in robot.arm()


def test_a_trajectory_ends_in_rest_should_no_further_message_come(begin: Begin, start: Any) -> None:
    slow = POSITION | {"limits": POSITION["limits"] | {"acceleration": [4.0]}}
    robot = begin(slow | {"command": {"topic": "commands", "kind": "position", "type": TRAJECTORY}})
    assert robot.arm() == "holding"
    start("sender", 0.9, 7)
    robot.probe.until(lambda: bool(robot.sent) and robot.sent[-1].message.points[0].positions[0] > 0.2)
    points = robot.sent[-1].message.points
    assert 2 < len(points) <= 10
    assert robot.sent[-1].message.joint_names == ["a"]
    seconds = np.array([point.time_from_start.sec + 1e-9 * point.time_from_start.nanosec for point in points])
    speeds = np.diff([point.positions[0] for point in points]) / np.diff(seconds)
    assert (np.diff(speeds) <= 1e-9).all()
    assert 0 <= speeds[-1] < 0.3


def test_a_mobile_base_receives_twists(begin: Begin) -> None:
    robot = begin(BASE)
    robot.is_sensed = False
    assert robot.arm() == "holding"
    robot.command(0.2, -0.3, number=1)
    robot.probe.until(lambda: bool(robot.sent) and robot.sent[-1].message.twist.angular.z == -0.3)
    twist = robot.sent[-1].message
    assert (twist.twist.linear.x, twist.header.frame_id) == (0.2, "base_link")
    assert twist.header.stamp.sec > 0
    robot.probe.add_service("gate/describe_parameters", DescribeParameters)
    names = ["limits.acceleration", "command.type"]
    request = DescribeParameters.Request(names=names)
    limits, kind = robot.probe.ask("gate/describe_parameters", request).descriptors
    assert all(each.description and each.read_only for each in (limits, kind))
    assert limits.floating_point_range[0].from_value == 0.0
    assert "std_msgs/msg/Float64MultiArray" in kind.additional_constraints


def test_another_publisher_stops_a_moving_robot(begin: Begin, start: Any) -> None:
    robot = begin(POSITION | {"limits": POSITION["limits"] | {"velocity": [0.1]}})
    assert robot.arm() == "holding"
    start("sender", 0.9, 7)
    robot.until("moving")
    other = robot.probe.create_publisher(Float64MultiArray, "commands", 1)
    # The gate does not wait for the name of a publisher that it has just found.
    assert robot.until("stopped").reason.startswith("expected no other publisher, got /commands: ")
    robot.probe.until(lambda: robot.arm() == "expected no other publisher, got /commands: /gate, /probe")
    robot.probe.destroy_publisher(other)
    robot.probe.until(lambda: robot.arm() in ("holding", "moving"))


def test_a_gate_whose_ticks_fail_for_ever_sends_its_last_output_at_once(begin: Begin) -> None:
    patience = 8.0  # seconds for which the gate would hold the last output
    gate, robot = begin(BASE | {"rest": {"timeout": patience}}, process="failing_gate")
    robot.is_sensed = False
    faults = robot.probe.create_publisher(String, "fail", 1)
    robot.probe.until(lambda: faults.get_subscription_count() > 0)
    assert robot.arm() == "holding"
    robot.command(0.2, -0.3, number=1)
    robot.probe.until(lambda: bool(robot.sent) and robot.sent[-1].message.twist.linear.x == 0.2)
    failed_at = time.monotonic()
    faults.publish(String(data="tick"))
    robot.probe.until(lambda: gate.popen.poll() is not None)
    assert time.monotonic() < failed_at + patience
    robot.probe.until(lambda: robot.sent[-1].message.twist.linear.x == 0.0)
    assert gate.finish()[0] != 0


def test_an_invalid_parameter_is_refused_in_one_line(start: Any, tmp_path: Path) -> None:
    tree = {**POSITION, "command": POSITION["command"] | {"topic": "gate/state"}}
    code, out, err = start("gate", "--ros-args", "--params-file", written(tmp_path, tree)).finish()
    assert (code, out, err.count("\n")) == (2, "", 1)
    assert "cannot open its topics and services" in err


def test_problems_of_the_joint_source_are_reported_before_and_when_arming(begin: Begin) -> None:
    robot = begin(POSITION | {"sensor": {"topic": "numbers"}})
    robot.probe.create_publisher(Float64MultiArray, "numbers", 1)
    heard, kind = reports(robot), "topics of sensor_msgs/msg/JointState: /joint_states"
    line = f"/numbers: no messages, published by /probe as std_msgs/msg/Float64MultiArray; {kind}"
    robot.probe.until(lambda: told(heard).get("source joints") == line)
    answer = robot.probe.ask("gate/arm", Trigger.Request())
    assert not answer.success
    assert answer.message == f"cannot arm: no usable joint state has been received; {line}"


def test_a_gate_arms_itself_only_while_all_its_listeners_are_simulated(begin: Begin) -> None:
    robot = begin(CALM | {"arms_itself": True})
    probe, heard = robot.probe, reports(robot)
    probe.add_node("simulated_robot").create_subscription(Float64MultiArray, "commands", lambda message: None, 1)
    expected = "arms_itself: expected only simulated robots on commands, got /probe"
    probe.until(lambda: any(each.status[0].message == f"waiting: {expected}" for each in heard))
    robot.until("disarmed")
    assert {state.state for state in robot.states} == {"disarmed"}
    probe.destroy_subscription(robot.listener)
    robot.until("holding")
    real = probe.create_subscription(Float64MultiArray, "commands", lambda message: None, 1)
    reason = "arms_itself: expected only simulated robots on commands, got "
    assert robot.until("disarmed").reason.startswith(reason)  # so that it sends nothing
    assert robot.arm().startswith(f"cannot arm: {reason}")
    assert robot.arm() == "holding"  # by a person, who may arm it for any robot
    probe.ask("gate/stop", Trigger.Request())
    robot.until("stopped")
    probe.destroy_subscription(real)
    heard.clear()
    probe.until(lambda: len(heard) > 3)  # seconds, in which it would arm itself
    assert robot.states[-1].state == "stopped"  # on request


def test_unusable_sensors_of_the_robot_node_prevent_arming(begin: Begin) -> None:
    robot = begin(CALM)
    obstacles = robot.probe.create_publisher(String, "robot/obstacle", LATCHED_QOS)
    robot.probe.until(lambda: obstacles.get_subscription_count() > 0)
    refusal = "cannot arm while the robot node cannot use its sensors: sensor arm: "

    def refused(reason: str) -> bool:
        if robot.states and robot.states[-1].state != "disarmed":  # it may have been armed before the message came
            robot.probe.ask("gate/stop", Trigger.Request())
        return robot.arm() == refusal + reason

    for reason in ("missing joints 'elbow'", "silent"):
        obstacles.publish(String(data=f"sensor arm: {reason}"))
        robot.probe.until(lambda: refused(reason))  # noqa: B023  # awaited in this step
        obstacles.publish(String(data=""))
        robot.probe.until(lambda: robot.arm() == "holding")


ACCELERATION, SPEED = 5.0, 1.5
VELOCITY = CALM | {
    "command": {"topic": "commands", "kind": "velocity"},
    "limits": {"minimum": [-2.0], "maximum": [2.0], "acceleration": [ACCELERATION]},
}


@pytest.fixture
def moving(begin: Begin, start: Any) -> tuple[Process, Any]:
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
    moving: tuple[Process, Any], start: Any, tmp_path: Path
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
