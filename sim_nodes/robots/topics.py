"""The topics of each practice robot: commands to values, readings to messages."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, ClassVar, Protocol

from builtin_interfaces.msg import Time
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray, Header, String

from sim_nodes.robots.hardware import Robot, RobotSettings
from sim_nodes.robots.joints import JointReadings
from sim_nodes.robots.motor_pendulum import MotorPendulumRobot, MotorPendulumSettings

SENSOR_QOS = QoSProfile(depth=10)  # as of the controllers of ros2_control
LATCHED_QOS = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
Send = Callable[[Any], None]


class RobotTopics(Protocol):
    """The topics of one robot.

    Attributes:
        robot: behind them.
        command_topics: on which it is commanded.
    """

    robot: Robot
    command_topics: tuple[str, ...]

    def publish(self, readings: Any, stamp: Time) -> None:
        """Publish what the sensors read at a time."""


class JointPublisher:
    """Publishes readings of joints, and once the robot's description.

    Args:
        node: the robot's node.
        description: URDF.
    """

    def __init__(self, node: Node, description: str) -> None:
        self._states = node.create_publisher(JointState, "joint_states", SENSOR_QOS)
        self._description = node.create_publisher(String, "robot_description", LATCHED_QOS)
        self._description.publish(String(data=description))

    def publish(self, readings: JointReadings, stamp: Time) -> None:
        """Publish what the sensors read at a time."""
        names, *values = readings
        position, velocity, effort = (list(each) for each in values)
        message = JointState(
            header=Header(stamp=stamp), name=names, position=position, velocity=velocity, effort=effort
        )
        self._states.publish(message)


class MotorPendulumTopics:
    """The pendulum's topics: torque in, joint state out.

    Args:
        node: the robot's node.
        settings: of the robot.
        send: sends the robot a command.
    """

    settings: ClassVar[type[RobotSettings]] = MotorPendulumSettings
    command_topics: tuple[str, ...] = ("effort_controller/commands",)

    def __init__(self, node: Node, settings: MotorPendulumSettings, send: Send) -> None:
        self.robot: Robot = (pendulum := MotorPendulumRobot(settings))
        self._joints = JointPublisher(node, pendulum.description())
        node.create_subscription(Float64MultiArray, self.command_topics[0], lambda m: send(m.data), SENSOR_QOS)

    def publish(self, readings: JointReadings, stamp: Time) -> None:
        """Publish what the sensors read at a time."""
        self._joints.publish(readings, stamp)
