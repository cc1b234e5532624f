"""The node of a simulated robot, a process that behaves like hardware in real time."""

import time
from collections.abc import Callable
from math import inf
from typing import Any

from builtin_interfaces.msg import Time as Stamp
from diagnostic_msgs.msg import DiagnosticStatus, KeyValue
from geometry_msgs.msg import Point, PointStamped, Pose, PoseStamped, Quaternion
from rclpy.node import Node
from rclpy.qos import QoSProfile
from rclpy.time import Time
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray, Header, String
from std_srvs.srv import Trigger
from trajectory_msgs.msg import JointTrajectory

from rkhs_ros.base.settings import entries
from rkhs_ros.nodes.core.diagnostics import Diagnostics, rivals
from rkhs_ros.nodes.core.messages import LATCHED_QOS
from rkhs_ros.nodes.core.parameters import declare, declared, given
from rkhs_ros.nodes.core.spin import ReportingNode, run, serve
from sim_nodes.robots import DEFAULT, SETTINGS, settings_of
from sim_nodes.robots.arm import POSITIONS, ArmReadings, ArmRobot, ArmSettings
from sim_nodes.robots.drives import JointCommand
from sim_nodes.robots.motor_pendulum import MotorPendulumRobot
from sim_nodes.robots.robot import SECOND_PUBLISHER, Hardware, Robot

SENSOR_QOS = QoSProfile(depth=10)  # like the controllers of ros2_control
LEFT_TIMEOUT_S = 9.0  # for the senders of commands to exit, before the node exits; a gate takes at most 8
REPORT_PERIOD_S = 0.1  # between reports of violations, and checks of the commands' publishers


class RobotTopics:
    """The topics of a robot: commands in; readings of the joints out, and its description once."""

    def __init__(self, node: Node, robot: Robot, topic: str, kind: type, hear: Callable[[Any], None]) -> None:
        self.robot, self.command_topic = robot, topic
        self._states = node.create_publisher(JointState, "joint_states", SENSOR_QOS)
        self._description = node.create_publisher(String, "robot_description", LATCHED_QOS)
        self._description.publish(String(data=robot.description()))
        node.create_subscription(kind, topic, hear, SENSOR_QOS)

    def publish(self, readings: Any, stamp: Stamp) -> None:
        """Publish the readings of the sensors, with their time stamp."""
        name, position, velocity, effort = map(list, readings)
        header = Header(stamp=stamp)
        self._states.publish(JointState(header=header, name=name, position=position, velocity=velocity, effort=effort))


class ArmTopics(RobotTopics):
    """The topics of the arm, which also publishes the poses of its tool and the mark, and starts episodes."""

    def __init__(self, node: Node, arm: ArmRobot, topic: str, kind: type, hear: Callable[[Any], None]) -> None:
        super().__init__(node, arm, topic, kind, hear)
        self._tool = node.create_publisher(PoseStamped, "end_effector", SENSOR_QOS)
        self._mark = node.create_publisher(PointStamped, "mark", SENSOR_QOS)

        def begin(request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
            arm.begin_episode()
            response.success = True
            return response

        node.create_service(Trigger, "~/begin_episode", begin)

    def publish(self, readings: ArmReadings, stamp: Stamp) -> None:
        """Publish the readings of the sensors, with their time stamp."""
        super().publish(readings.joints, stamp)
        header = Header(stamp=stamp, frame_id="panda_link0")
        tool, mark = (Point(**dict(zip("xyz", place, strict=True))) for place in (readings.tool[0], readings.mark))
        turn = Quaternion(**dict(zip("xyzw", readings.tool[1], strict=True)))
        self._tool.publish(PoseStamped(header=header, pose=Pose(position=tool, orientation=turn)))
        self._mark.publish(PointStamped(header=header, point=mark))


def topics_of(node: Node, settings: Any, send: Callable[[Any], None]) -> RobotTopics:
    """Return the topics of a new robot, which `send` sends commands."""
    if not isinstance(settings, ArmSettings):
        pendulum, topic = MotorPendulumRobot(settings), "effort_controller/commands"
        return RobotTopics(node, pendulum, topic, Float64MultiArray, lambda message: send(message.data))
    arm, name = ArmRobot(settings), settings.controller
    if name == POSITIONS:
        topic, kind = f"{name}/commands", Float64MultiArray
        return ArmTopics(node, arm, topic, kind, lambda message: send(JointCommand((), (0.0,), (tuple(message.data),))))
    topic, kind = f"{name}/joint_trajectory", JointTrajectory
    return ArmTopics(node, arm, topic, kind, lambda message: send(trajectory(message, settings.speed)))


def trajectory(message: JointTrajectory, speed: float) -> JointCommand:
    """Return the command of a trajectory, in the robot's time; it starts on arrival, whatever its stamp."""
    durations = [point.time_from_start for point in message.points]
    times = tuple(speed * (duration.sec + 1e-9 * duration.nanosec) for duration in durations)
    return JointCommand(tuple(message.joint_names), times, tuple(tuple(point.positions) for point in message.points))


class SimulatedRobotNode(ReportingNode):
    """A simulated robot.

    Owns the robot with its wires, and the clock by which it moves. Like hardware, it only has a protective stop, which
    triggers when a limit has already been exceeded, latches until it is reset, and is counted.
    """

    def open(self) -> None:
        """Create the robot and open its topics and services."""
        tree = given(self, needs_section=True)
        name = declared(self, tree, "robot", DEFAULT, f"which robot: {', '.join(SETTINGS)}")
        settings = settings_of(name, tree)
        declare(self, entries(settings))
        self._speed = settings.speed
        self._report_at = 0.0  # monotonic time, seconds
        self._published: tuple[object, ...] = ()
        self._end_at = inf  # monotonic time, seconds; finite once the node has been asked to exit
        self._crowded = ""
        self._topics = topics_of(self, settings, self._command)
        self._hardware = Hardware(self._topics.robot)
        self._violations = self.create_publisher(DiagnosticStatus, "~/violations", LATCHED_QOS)
        self.diagnostics = Diagnostics(self, self._report)
        self.create_service(Trigger, "~/reset_protective_stop", self._reset)
        self._begin = time.monotonic()
        self.get_logger().info(f"{name} is running, at {self._speed:g} times real time")

    def heartbeat(self) -> float:
        """Advance the robot and publish the readings of its sensors; return the seconds until its next event."""
        system_ns, now = time.time_ns(), self._now()  # of the two clocks, the system's may jump
        for moment, readings in self._hardware.advance(now):
            stamp = Time(nanoseconds=system_ns - round(1e9 * (now - moment) / self._speed))
            self._topics.publish(readings, stamp.to_msg())
        self.diagnostics.steps = self._hardware.steps
        self.diagnostics.stuck = self._topics.robot.state.protection.reason
        self._check_commands()
        wait = max(self._hardware.next_event() - self._now(), 0.0) / self._speed
        return min(wait, self.diagnostics.heartbeat(), REPORT_PERIOD_S)

    def may_end(self) -> bool:
        """Wait until the senders of commands have exited: they need the sensors to bring the robot to rest."""
        now = time.monotonic()
        self._end_at = min(self._end_at, now + LEFT_TIMEOUT_S)
        is_left = not self.count_publishers(self._topics.command_topic)
        return is_left or now >= self._end_at

    def _now(self) -> float:
        return (time.monotonic() - self._begin) * self._speed

    def _command(self, command: Any) -> None:
        self._hardware.send(self._now(), command)

    def _check_commands(self) -> None:
        """Stop if commands have two publishers; publish violations at once, and other changes periodically."""
        protection = self._topics.robot.state.protection
        now = time.monotonic()
        if now < self._report_at and self._published == (protection.violations, protection.reason):
            return
        before, self._crowded = self._crowded, rivals(self, self._topics.command_topic)
        if self._crowded and not before:
            robot, reason = self._topics.robot, f"expected one publisher, got {self._crowded}"
            robot.state = robot.state.tripped(SECOND_PUBLISHER, reason)
        self._publish_report()
        self._report_at = now + REPORT_PERIOD_S

    def _publish_report(self) -> None:
        protection = self._topics.robot.state.protection
        if protection.reason and protection.reason not in self._published:
            self.get_logger().error(f"protective stop: {protection.reason}")
        self._published = (protection.violations, protection.reason)
        self._violations.publish(
            DiagnosticStatus(
                level=DiagnosticStatus.ERROR if protection.is_stopped else DiagnosticStatus.OK,
                name=str(self.get_fully_qualified_name()),
                message=protection.reason,
                values=[KeyValue(key=key, value=str(value)) for key, value in self._hardware.report().items()],
            )
        )

    def _reset(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        if self._crowded:
            response.message = f"expected one publisher, got {self._crowded}"
            return response
        self._topics.robot.state = self._topics.robot.state.reset()
        response.success = True
        return response

    def _report(self) -> dict[str, object]:
        behind = (self._now() - self._hardware.time) / self._speed
        return {**self._hardware.report(), "seconds behind": f"{behind:.3f}"}


def main() -> None:
    """Run the node of a simulated robot."""
    run(SimulatedRobotNode, "simulated_robot", serve)


if __name__ == "__main__":
    main()
