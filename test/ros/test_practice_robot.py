"""A practice robot over topics behaves as hardware: by the wall clock, with a protective stop that counts."""

import math
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import pytest
import yaml
from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.node import Node
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray, String
from std_srvs.srv import Trigger

from sim_nodes.robots.motor_pendulum import KINDS
from sim_nodes.robots.topics import LATCHED_QOS, SENSOR_QOS
from test.ros.conftest import Probe, Process

Start = Callable[..., Process]
TORQUE = "effort_controller/commands"
RESET = "practice_robot/reset_protective_stop"
PLAIN = {"process_noise": 0.0, "position_noise": 0.0, "velocity_noise": 0.0, "latency": 0.0, "jitter": 0.0}


class Operator:
    """What stands at a practice robot: it hears the joints and the violations, and commands."""

    def __init__(self, probe: Probe, topic: str = TORQUE) -> None:
        self.probe = probe
        self.joints: list[JointState] = []
        self.told: list[DiagnosticStatus] = []
        probe.create_subscription(JointState, "joint_states", self.joints.append, SENSOR_QOS)
        probe.create_subscription(DiagnosticStatus, "practice_robot/violations", self.told.append, LATCHED_QOS)
        probe.add_service(RESET, Trigger)
        self._commands = probe.create_publisher(Float64MultiArray, topic, SENSOR_QOS)
        probe.until(lambda: bool(self.joints and self.told) and self._commands.get_subscription_count() == 1)

    @property
    def state(self) -> dict[str, str]:
        return {value.key: value.value for value in self.told[-1].values}

    @property
    def counts(self) -> dict[str, int]:
        return {kind: int(self.state[kind]) for kind in KINDS}

    def command(self, *values: float) -> None:
        """Command, and wait until it was heard."""
        heard = int(self.state["commands"])
        self._commands.publish(Float64MultiArray(data=values))
        self.probe.until(lambda: int(self.state["commands"]) == heard + 1)

    def move_on(self) -> JointState:
        """Return a joint state that was taken from now on."""
        now = time.time()
        self.probe.until(lambda: stamp(self.joints[-1]) > now)
        return self.joints[-1]

    def reset(self) -> Trigger.Response:
        return self.probe.ask(RESET, Trigger.Request())


def stamp(message: JointState) -> float:
    return float(message.header.stamp.sec + 1e-9 * message.header.stamp.nanosec)


@pytest.fixture
def robot(start: Start, probe: Probe, tmp_path: Path) -> Callable[..., Operator]:
    def begin(**parameters: Any) -> Operator:
        file = tmp_path / "robot.yaml"
        file.write_text(yaml.safe_dump({"/**/practice_robot": {"ros__parameters": {**PLAIN, **parameters}}}))
        start("practice_robot", "--ros-args", "--params-file", file)
        return Operator(probe)

    return begin


def test_the_pendulum_moves_by_the_wall_clock(robot: Callable[..., Operator]) -> None:
    operator = robot(robot="motor_pendulum", sensor_rate=100.0)
    still = operator.move_on()
    assert (list(still.name), still.position[0], still.velocity[0]) == (["motor"], -math.pi, 0.0)
    operator.command(0.5)
    first = operator.move_on()
    operator.probe.settle(1.0)
    last = operator.move_on()
    seconds = stamp(last) - stamp(first)
    assert last.effort[0] == 0.5
    assert last.velocity[0] - first.velocity[0] == pytest.approx(0.5 * seconds, abs=0.01)
    between = [stamp(each) for each in operator.joints if stamp(first) <= stamp(each) <= stamp(last)]
    assert between == sorted(set(between))
    assert abs(len(between) - 1 - 100.0 * seconds) < 0.2 * 100.0 * seconds  # under load some are lost on their way
    assert set(operator.counts.values()) == {0}


def test_with_a_speed_factor_all_goes_faster(robot: Callable[..., Operator]) -> None:
    operator = robot(speed=10.0, sensor_rate=20.0)
    operator.command(0.2)
    first = operator.move_on()
    operator.probe.settle(0.5)
    last = operator.move_on()
    seconds = stamp(last) - stamp(first)
    assert last.velocity[0] - first.velocity[0] == pytest.approx(0.2 * 10.0 * seconds, abs=0.01)


def bad(kind: str) -> Sequence[float]:
    return {"malformed": (0.0, 0.0), "non_finite": (math.nan,), "torque": (3.5,), "torque_step": (-1.0,)}[kind]


def test_bad_commands_stop_the_robot_until_it_is_reset(robot: Callable[..., Operator]) -> None:
    operator = robot(**{"limits.torque_step": 1.5})
    expected = dict.fromkeys(KINDS, 0)
    for kind in ("non_finite", "malformed", "torque", "torque_step"):
        operator.command(1.0)
        operator.command(*bad(kind))
        expected[kind] += 1
        assert operator.counts == expected
        assert operator.told[-1].level == DiagnosticStatus.ERROR
        assert operator.told[-1].message.startswith(kind)
        operator.command(1.0)  # latched: it is not taken
        operator.probe.until(lambda: operator.move_on().velocity[0] == 0.0)
        assert operator.move_on().effort[0] == 0.0
        assert operator.reset().success
        operator.probe.until(lambda: operator.told[-1].level == DiagnosticStatus.OK)
    operator.command(1.0)
    assert operator.move_on().effort[0] == 1.0
    assert operator.counts == expected


def test_a_second_publisher_of_commands_stops_the_robot(robot: Callable[..., Operator]) -> None:
    operator = robot()
    operator.command(0.1)
    other = Node("stranger", context=operator.probe.context)
    stranger = other.create_publisher(Float64MultiArray, TORQUE, SENSOR_QOS)
    operator.probe.until(lambda: operator.counts["second_publisher"] == 1)
    refused = operator.reset()
    assert not refused.success
    assert "expected one publisher" in refused.message
    other.destroy_publisher(stranger)
    operator.probe.until(lambda: operator.reset().success)
    operator.command(0.1)
    assert operator.counts == {**dict.fromkeys(KINDS, 0), "second_publisher": 1}
    other.destroy_node()


def test_a_robot_that_watches_the_time_stops_by_itself(robot: Callable[..., Operator]) -> None:
    operator = robot(command_timeout=0.3)
    operator.command(0.1)
    operator.probe.until(lambda: operator.counts["command_timeout"] == 1)
    assert float(operator.state["seconds since the last command"]) > 0.3
    assert operator.told[-1].message.startswith("command_timeout")


def test_viewers_are_given_the_robots_description(robot: Callable[..., Operator]) -> None:
    operator = robot()
    found: list[String] = []
    operator.probe.create_subscription(String, "robot_description", found.append, LATCHED_QOS)
    operator.probe.until(lambda: bool(found))
    assert '<joint name="motor"' in found[0].data


@pytest.mark.parametrize(
    ("parameters", "message"),
    [
        ({"robot": "motor_pendulun"}, "unknown robot 'motor_pendulun', did you mean 'motor_pendulum'?"),
        ({"spede": 1.0}, "unknown key 'spede', did you mean 'speed'?"),
        ({"limits": {"torque": "much"}}, "limits.torque: expected a number, got 'much'"),
    ],
)
def test_parameters_that_do_not_fit_are_refused(
    start: Start, domain: int, tmp_path: Path, parameters: dict[str, Any], message: str
) -> None:
    file = tmp_path / "robot.yaml"
    file.write_text(yaml.safe_dump({"/**/practice_robot": {"ros__parameters": parameters}}))
    assert start("practice_robot", "--ros-args", "--params-file", file).finish() == (2, "", f"error: {message}\n")
