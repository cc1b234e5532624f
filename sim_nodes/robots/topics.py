"""The topics of each simulated robot: conversion of commands and readings."""

from collections.abc import Callable
from functools import partial
from typing import Any, Protocol

from builtin_interfaces.msg import Time
from geometry_msgs.msg import Point, PointStamped, PoseStamped, Quaternion
from geometry_msgs.msg import Pose as PoseMessage
from rclpy.node import Node
from rclpy.qos import QoSProfile
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray, Header, String
from std_srvs.srv import Trigger
from trajectory_msgs.msg import JointTrajectory

from rkhs_ros.nodes.core.messages import LATCHED_QOS
from sim_nodes.robots.arm import POSITIONS, ArmReadings, ArmRobot, ArmSettings
from sim_nodes.robots.drives import JointCommand
from sim_nodes.robots.motor_pendulum import MotorPendulumRobot, MotorPendulumSettings
from sim_nodes.robots.robot import JointReadings, Robot

SENSOR_QOS = QoSProfile(depth=10)  # like the controllers of ros2_control
Send = Callable[[Any], None]


def trajectory(message: JointTrajectory, speed: float) -> JointCommand:
    """Return the command of a trajectory message, which starts on arrival and ignores the stamp.

    Args:
        message: the trajectory.
        speed: factor of its times.
    """
    durations = [point.time_from_start for point in message.points]
    times = tuple(speed * (duration.sec + 1e-9 * duration.nanosec) for duration in durations)
    return JointCommand(tuple(message.joint_names), times, tuple(tuple(point.positions) for point in message.points))


def serve_episodes(node: Node, begin: Callable[[], None]) -> None:
    """Offer the service that starts an episode."""

    def answer(request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        begin()
        response.success = True
        return response

    node.create_service(Trigger, "~/begin_episode", answer)


class RobotTopics(Protocol):
    """The topics of one robot.

    Attributes:
        robot: the robot.
        command_topics: topics of its commands.
    """

    robot: Robot[Any]
    command_topics: tuple[str, ...]

    def publish(self, readings: Any, stamp: Time) -> None:
        """Publish the readings of the sensors, with their time stamp."""


class JointPublisher:
    """Publishes the readings of joints, and once the robot's description.

    Args:
        node: the robot's node.
        description: URDF.
    """

    def __init__(self, node: Node, description: str) -> None:
        self._states = node.create_publisher(JointState, "joint_states", SENSOR_QOS)
        self._description = node.create_publisher(String, "robot_description", LATCHED_QOS)
        self._description.publish(String(data=description))

    def publish(self, readings: JointReadings, stamp: Time) -> None:
        """Publish the readings of the sensors, with their time stamp."""
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
        send: sends a command to the robot.
    """

    command_topics: tuple[str, ...] = ("effort_controller/commands",)

    def __init__(self, node: Node, settings: MotorPendulumSettings, send: Send) -> None:
        self.robot: Robot[Any] = (pendulum := MotorPendulumRobot(settings))
        self._joints = JointPublisher(node, pendulum.description())
        node.create_subscription(Float64MultiArray, self.command_topics[0], lambda m: send(m.data), SENSOR_QOS)

    def publish(self, readings: JointReadings, stamp: Time) -> None:
        """Publish the readings of the sensors, with their time stamp."""
        self._joints.publish(readings, stamp)


class ArmTopics:
    """The arm's topics: positions or trajectories in; joint state, the tool's pose and the mark out.

    Args:
        node: the robot's node.
        settings: of the robot.
        send: sends a command to the robot.
    """

    def __init__(self, node: Node, settings: ArmSettings, send: Send) -> None:
        self.robot: Robot[Any] = (arm := ArmRobot(settings))
        self._joints = JointPublisher(node, arm.description())
        self._tool = node.create_publisher(PoseStamped, "end_effector", SENSOR_QOS)
        self._mark = node.create_publisher(PointStamped, "mark", SENSOR_QOS)
        serve_episodes(node, arm.begin_episode)
        if settings.controller == POSITIONS:
            self.command_topics: tuple[str, ...] = (f"{POSITIONS}/commands",)
            kind, command = Float64MultiArray, lambda message: JointCommand.of_positions(message.data)
        else:
            self.command_topics = (f"{settings.controller}/joint_trajectory",)
            kind, command = JointTrajectory, partial(trajectory, speed=settings.speed)
        node.create_subscription(kind, self.command_topics[0], lambda m: send(command(m)), SENSOR_QOS)

    def publish(self, readings: ArmReadings, stamp: Time) -> None:
        """Publish the readings of the sensors, with their time stamp."""
        self._joints.publish(readings.joints, stamp)
        header = Header(stamp=stamp, frame_id="panda_link0")
        (x, y, z), turn = readings.tool
        pose = PoseMessage(
            position=Point(x=x, y=y, z=z), orientation=Quaternion(**dict(zip("xyzw", turn, strict=True)))
        )
        self._tool.publish(PoseStamped(header=header, pose=pose))
        self._mark.publish(PointStamped(header=header, point=Point(**dict(zip("xyz", readings.mark, strict=True)))))
