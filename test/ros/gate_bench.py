"""A commander of a gate and its hardware, in one test node."""

import threading
import time
from collections.abc import Callable, Iterator
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

import pytest
import yaml
from geometry_msgs.msg import TwistStamped
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray
from std_srvs.srv import Trigger
from trajectory_msgs.msg import JointTrajectory

from rkhs_interfaces.msg import Command, GateReport, GateState
from rkhs_ros.nodes.core.messages import LATCHED_QOS, LOCKSTEP_QOS
from rkhs_ros.nodes.robot.gate_node import GateNode
from test.ros.conftest import Probe, Process

TIMEOUT = 1.0  # of commands and sensors: a busy machine is no reason to stop
FLOATS, TRAJECTORY = "std_msgs/msg/Float64MultiArray", "trajectory_msgs/msg/JointTrajectory"
OUTPUTS = {FLOATS: Float64MultiArray, TRAJECTORY: JointTrajectory, "geometry_msgs/msg/TwistStamped": TwistStamped}
POSITION = {
    "joints": ["a"],
    "command": {"topic": "commands", "kind": "position"},
    "limits": {"minimum": [-1.0], "maximum": [1.0], "velocity": [2.0], "acceleration": [20.0]},
    "command_timeout": TIMEOUT,
    "stale_after": TIMEOUT,
}
CALM = POSITION | {"command_timeout": 5.0, "stale_after": 5.0}  # never late, however busy the machine
BASE = {
    "joints": ["linear.x", "angular.z"],
    "sensor": {"topic": ""},
    "command": {"topic": "cmd_vel", "type": "geometry_msgs/msg/TwistStamped", "kind": "velocity"},
    "limits": {"minimum": [-1.0, -1.0], "maximum": [1.0, 1.0], "acceleration": [5.0, 5.0]},
    "command_timeout": 5.0,
}


class Output(NamedTuple):
    """What the gate sent: when it was heard and what, which of its outputs it was, and when it was sent.

    The probe may lose some: the hardware takes the newest one, so the gate keeps no others for it.
    """

    heard_at: float
    message: Any
    number: int
    sent_ns: int


class Robot:
    """What the gate commands, in this process: it tells of its joint all the time, and keeps what it is sent.

    Owns a thread, as its joint is to be sensed while the test waits for other things.
    """

    def __init__(self, probe: Probe, output: str) -> None:
        self.position, self.is_sensed = 0.0, True
        self.sent: list[Output] = []
        self.reports: list[GateReport] = []
        self.states: list[GateState] = []
        self.probe = probe
        self.listener = probe.create_subscription(
            OUTPUTS[output], "cmd_vel" if "Twist" in output else "commands", self._obey, LOCKSTEP_QOS
        )
        probe.create_subscription(GateReport, "gate/report", self.reports.append, LOCKSTEP_QOS)
        probe.create_subscription(GateState, "gate/state", self.states.append, LATCHED_QOS)
        self.commands = probe.create_publisher(Command, "command", LOCKSTEP_QOS)
        self._joints = probe.create_publisher(JointState, "joint_states", 5)
        for name in ("arm", "stop"):
            probe.add_service(f"gate/{name}", Trigger)
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._tell, daemon=True)
        self._thread.start()

    def arm(self) -> str:
        """Ask until the gate is armed; return the last answer."""
        self.probe.until(lambda: self.commands.get_subscription_count() > 0 and bool(self.states))
        answers: list[str] = []

        def answered() -> bool:
            answers.append(str(self.probe.ask("gate/arm", Trigger.Request()).message))
            return not (self.is_sensed and "no messages" in answers[-1])

        self.probe.until(answered)
        return answers[-1]

    def command(self, *values: float, number: int, instance: int = 7) -> GateReport:
        """Send a command and return what was reported of it."""
        stamp = self.probe.get_clock().now().to_msg()
        self.commands.publish(Command(instance=instance, number=number, stamp=stamp, values=values, hold=not values))
        self.probe.until(lambda: bool(self.reports) and self.reports[-1].number == number)
        return self.reports[-1]

    def until(self, state: str) -> GateState:
        self.probe.until(lambda: bool(self.states) and self.states[-1].state == state)
        return self.states[-1]

    def moved_last(self) -> int:
        return max(later.number for earlier, later in pairwise(self.sent) if earlier.message != later.message)

    def close(self) -> None:
        self._ended.set()
        self._thread.join()

    def _obey(self, message: Any, info: dict[str, int]) -> None:
        number, sent_ns = info["publication_sequence_number"], info["source_timestamp"]
        self.sent.append(Output(time.monotonic(), message, number, sent_ns))
        if isinstance(message, Float64MultiArray):
            self.position = message.data[0]

    def _tell(self) -> None:
        while not self._ended.wait(0.01):
            message = JointState(name=["other", "a"], position=[9.0, self.position])
            message.header.stamp = self.probe.get_clock().now().to_msg()
            if self.is_sensed:
                self._joints.publish(message)


@pytest.fixture
def begin(start: Callable[..., Process], run_node: Any, probe: Probe, tmp_path: Path) -> Iterator[Callable[..., Any]]:
    """Start a gate with a robot behind it, in this process or, with its name given, in one of its own."""
    robots = []

    def make(tree: dict[str, Any], process: str = "") -> Any:
        robots.append(Robot(probe, tree["command"].get("type", FLOATS)))
        arguments = ("--params-file", written(tmp_path, tree))
        if process:
            return start(process, "--ros-args", *arguments), robots[-1]
        run_node(GateNode, "gate", *arguments)
        return robots[-1]

    yield make
    for robot in robots:
        robot.close()


def written(folder: Path, tree: dict[str, Any]) -> Path:
    """Write a parameter file of a gate."""
    file = folder / "gate.yaml"
    file.write_text(yaml.safe_dump({"/**/gate": {"ros__parameters": tree}}))
    return file
