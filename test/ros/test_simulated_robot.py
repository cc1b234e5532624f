"""A simulated robot over topics behaves like hardware: in real time, with a counted protective stop."""

import math
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import PointStamped, PoseStamped
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray, String
from std_srvs.srv import Trigger

from rkhs_ros.nodes.core.messages import LATCHED_QOS
from sim_nodes.robots import drives, motor_pendulum
from sim_nodes.robots.arm import HOME
from sim_nodes.robots.simulated_robot_node import SENSOR_QOS, SimulatedRobotNode
from test.ros.conftest import Probe

TORQUE = "effort_controller/commands"
RESET, EPISODE = "simulated_robot/reset_protective_stop", "simulated_robot/begin_episode"
EXACT = {"position_noise": 0.0, "velocity_noise": 0.0, "latency": 0.0, "jitter": 0.0}


class Operator:
    """What stands at a simulated robot: it hears the joints and the violations, and commands."""

    def __init__(self, probe: Probe, topic: str, kind: Any) -> None:
        self.probe = probe
        self.joints: list[JointState] = []
        self.told: list[DiagnosticStatus] = []
        probe.create_subscription(JointState, "joint_states", self.joints.append, SENSOR_QOS)
        probe.create_subscription(DiagnosticStatus, "simulated_robot/violations", self.told.append, LATCHED_QOS)
        probe.add_service(RESET, Trigger)
        self._commands = probe.create_publisher(kind, topic, SENSOR_QOS)
        probe.until(lambda: bool(self.joints and self.told) and self._commands.get_subscription_count() == 1)

    @property
    def state(self) -> dict[str, str]:
        return {value.key: value.value for value in self.told[-1].values}

    @property
    def violations(self) -> dict[str, int]:
        counts = {kind: int(self.state.get(kind, "0")) for kind in {*motor_pendulum.KINDS, *drives.KINDS}}
        return {kind: count for kind, count in counts.items() if count}

    def command(self, *values: float) -> None:
        """Command, and wait until it was heard."""
        self.send(Float64MultiArray(data=values))

    def send(self, command: Any) -> None:
        """Send a command, and wait until it was heard."""
        heard = int(self.state["commands"])
        self._commands.publish(command)
        self.probe.until(lambda: int(self.state["commands"]) == heard + 1)

    def move_on(self) -> JointState:
        """Return a joint state that was taken from now on."""
        now = time.time()
        self.probe.until(lambda: stamp(self.joints[-1]) > now)
        return self.joints[-1]

    def reset(self) -> Trigger.Response:
        return self.probe.ask(RESET, Trigger.Request())


def stamp(message: Any) -> float:
    return float(message.header.stamp.sec + 1e-9 * message.header.stamp.nanosec)


@pytest.fixture
def robot(run_node: Callable[..., object], probe: Probe, tmp_path: Path) -> Callable[..., Operator]:
    def begin(topic: str = TORQUE, kind: Any = Float64MultiArray, **parameters: Any) -> Operator:
        file = tmp_path / "robot.yaml"
        file.write_text(yaml.safe_dump({"/**/simulated_robot": {"ros__parameters": {**EXACT, **parameters}}}))
        run_node(SimulatedRobotNode, "simulated_robot", "--params-file", file)
        return Operator(probe, topic, kind)

    return begin


def test_the_pendulum_moves_in_real_time(robot: Callable[..., Operator]) -> None:
    operator = robot(sensor_rate=100.0, process_noise=0.0)
    still = operator.move_on()
    assert (list(still.name), still.position[0], still.velocity[0]) == (["motor"], -math.pi, 0.0)
    operator.command(0.5)
    first = operator.move_on()
    operator.probe.settle(1.0)
    last = operator.move_on()
    seconds = stamp(last) - stamp(first)
    assert last.effort[0] == 0.5
    assert last.velocity[0] - first.velocity[0] == pytest.approx(0.5 * seconds, abs=0.01)
    assert operator.violations == {}
    found: list[String] = []
    operator.probe.create_subscription(String, "robot_description", found.append, LATCHED_QOS)
    operator.probe.until(lambda: bool(found))
    assert '<joint name="motor"' in found[0].data


def test_invalid_commands_stop_the_robot_until_it_is_reset(robot: Callable[..., Operator]) -> None:
    operator = robot()
    expected: dict[str, int] = {}
    for kind, bad in {"malformed": (0.0, 0.0), "torque": (3.5,)}.items():
        operator.command(1.0)
        operator.command(*bad)
        expected[kind] = 1
        assert operator.violations == expected
        assert operator.told[-1].level == DiagnosticStatus.ERROR
        assert operator.told[-1].message.startswith(kind)
        operator.command(1.0)  # latched: it is not taken
        operator.probe.until(lambda: operator.move_on().velocity[0] == 0.0)
        assert operator.move_on().effort[0] == 0.0
        assert operator.reset().success
        operator.probe.until(lambda: operator.told[-1].level == DiagnosticStatus.OK)
    operator.command(1.0)
    assert operator.move_on().effort[0] == 1.0
    assert operator.violations == expected


@pytest.fixture
def arm(robot: Callable[..., Operator]) -> Callable[..., Operator]:
    pytest.importorskip("pybullet")
    return partial(robot, robot="arm")


def hear(operator: Operator, topic: str, kind: Any) -> Any:
    """Return what is next heard on a topic."""
    heard: list[Any] = []
    subscription = operator.probe.create_subscription(kind, topic, heard.append, SENSOR_QOS)
    operator.probe.until(lambda: bool(heard))
    operator.probe.destroy_subscription(subscription)
    return heard[0]


def place(message: PointStamped | PoseStamped) -> np.ndarray:
    point = message.point if isinstance(message, PointStamped) else message.pose.position
    return np.array([point.x, point.y, point.z])


def test_the_arm_receives_positions_and_publishes_its_tool_and_the_mark(arm: Callable[..., Operator]) -> None:
    operator = arm(topic="position_controller/commands")
    np.testing.assert_allclose(operator.move_on().position, HOME, atol=0.01)
    tool = hear(operator, "end_effector", PoseStamped)
    mark = hear(operator, "mark", PointStamped)
    assert mark.header.frame_id == tool.header.frame_id == "panda_link0"
    assert np.linalg.norm(place(tool) - place(mark)) < 0.5
    operator.command(*(HOME + 0.05))
    operator.probe.until(lambda: bool(np.allclose(operator.joints[-1].position, HOME + 0.05, atol=0.01)))
    assert np.linalg.norm(place(hear(operator, "end_effector", PoseStamped)) - place(tool)) > 0.01
    assert operator.violations == {}
    operator.probe.add_service(EPISODE, Trigger)
    assert operator.probe.ask(EPISODE, Trigger.Request()).success
    operator.move_on()
    assert np.linalg.norm(place(hear(operator, "mark", PointStamped)) - place(mark)) > 0.05
    operator.command(*(HOME + 0.5))
    assert operator.violations == {"step": 1}
    assert operator.told[-1].message.startswith("step: panda_joint1: expected at most 0.1 rad")
