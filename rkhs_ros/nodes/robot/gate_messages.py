"""The gate's messages, converted to and from its values, and the topics on which other nodes request a stop."""

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
from builtin_interfaces.msg import Time as Stamp
from geometry_msgs.msg import Twist, TwistStamped
from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy
from rclpy.time import Time
from sensor_msgs.msg import JointState
from std_msgs.msg import Bool, Float64, Float64MultiArray
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

import rkhs_interfaces.msg as msg
from rkhs_ros.base.validation import require
from rkhs_ros.nodes.core.diagnostics import full_name
from rkhs_ros.policies.messages import doubles
from rkhs_ros.rkhs.kernels import Array
from rkhs_ros.robot.gate_settings import FLOAT, FLOATS, TRAJECTORY, TWIST, TWIST_STAMPED, GateSettings
from rkhs_ros.robot.gate_state import CommandReport, Publishers, StopRequests
from rkhs_ros.robot.limits import Limits, Sensed, Setpoint, braking
from rkhs_ros.robot.sensors import missing_joints

TYPES = {
    FLOATS: Float64MultiArray,
    FLOAT: Float64,
    TRAJECTORY: JointTrajectory,
    TWIST: Twist,
    TWIST_STAMPED: TwistStamped,
}


def seconds_of(stamp: Stamp) -> float:
    """Convert a stamp of the system clock to the monotonic clock, in seconds.

    The gate uses the monotonic clock, which corrections of the system clock do not affect. If the process is held up
    between the two readings, the stamp appears too old, never too new.
    """
    now, now_ns = time.monotonic(), time.time_ns()
    return now - 1e-9 * (now_ns - (stamp.sec * 1_000_000_000 + stamp.nanosec))


def sensed_of(message: JointState, joints: Sequence[str]) -> Sensed:
    """Return the state of joints in a message, nan for fields that it omits; raise ValueError if one is missing."""
    names = list(message.name)
    if missing := missing_joints(joints, names):
        raise ValueError(missing)
    places = [names.index(joint) for joint in joints]
    return Sensed(
        seconds_of(message.header.stamp),
        *(
            np.array(values)[places] if len(values) == len(names) else np.full(len(joints), np.nan)
            for values in (message.position, message.velocity, message.effort)
        ),
    )


def report_message(command: msg.Command, report: CommandReport) -> msg.GateReport:
    """Return the gate's report message of a command."""
    return msg.GateReport(
        instance=command.instance,
        number=command.number,
        stamp=_stamp(),
        asked=command.values,
        executed=doubles(report.executed),
        flags=int(report.flags),
    )


def hardware_message(settings: GateSettings, limits: Limits, motion: Setpoint) -> Any:
    """Return an output as a message of the hardware's type."""
    if settings.command.type == FLOATS:
        return Float64MultiArray(data=doubles(motion.value))
    if settings.command.type == FLOAT:
        return Float64(data=float(motion.value[0]))
    if settings.command.type == TRAJECTORY:
        return _trajectory(settings, limits, motion)
    twist = _twist(settings.joints, motion.value)
    return twist if settings.command.type == TWIST else _stamped(twist, settings.command.frame)


def _trajectory(settings: GateSettings, limits: Limits, motion: Setpoint) -> JointTrajectory:
    """Return the next positions and a braking trajectory, which the hardware executes if no further message arrives."""
    points = [
        JointTrajectoryPoint(
            positions=doubles(values), time_from_start=Duration(seconds=settings.period + seconds).to_msg()
        )
        for seconds, values in braking(limits, settings.period, motion)
    ]
    return JointTrajectory(joint_names=settings.joints, points=points)


def _twist(axes: Sequence[str], values: Array) -> Twist:
    message = Twist()
    for axis, value in zip(axes, values.tolist(), strict=True):
        part, _, name = axis.partition(".")
        setattr(getattr(message, part), name, value)
    return message


def _stamped(twist: Twist, frame: str) -> TwistStamped:
    message = TwistStamped(twist=twist)
    message.header.stamp = _stamp()
    message.header.frame_id = frame
    return message


def _stamp() -> Stamp:
    return Time(nanoseconds=time.time_ns()).to_msg()


# A transient-local subscription does not match a volatile publisher, nor a reliable one a best-effort one. For any
# publisher, one of these is the best match. They keep all messages, so that none replaces an unread request.
QOS = tuple(
    QoSProfile(history=HistoryPolicy.KEEP_ALL, reliability=reliability, durability=durability)
    for reliability, durability in (
        (ReliabilityPolicy.RELIABLE, DurabilityPolicy.TRANSIENT_LOCAL),
        (ReliabilityPolicy.RELIABLE, DurabilityPolicy.VOLATILE),
        (ReliabilityPolicy.BEST_EFFORT, DurabilityPolicy.VOLATILE),
    )
)


class StopTopics:
    """Subscriptions to topics on which other nodes request a stop; owns the requests of each topic."""

    def __init__(self, node: Node, timeouts: Mapping[str, float], changed: Callable[[], None]) -> None:
        self._node = node
        self._changed = changed
        names = {node.resolve_topic_name(topic): timeout for topic, timeout in timeouts.items()}
        require(len(names) == len(timeouts), "stop_topics", "different topics", ", ".join(timeouts))
        self._requests = {topic: StopRequests(topic, timeout) for topic, timeout in names.items()}
        for topic in names:
            for number, qos in enumerate(QOS):
                node.create_subscription(Bool, topic, partial(self._hear, topic, number), qos)

    def reason(self) -> str:
        """Return why the robot must stop; empty if it need not."""
        now = time.monotonic()
        for topic in self._requests:
            self._count(topic)
        return "; ".join(filter(None, (each.reason(now) for each in self._requests.values())))

    def drop_departed(self) -> None:
        """Remove requests of publishers that no longer exist; only an operator who arms the gate may do so."""
        for topic in self._requests:
            self._requests[topic] = self._count(topic).without_departed()

    def _hear(self, topic: str, subscription: int, message: Bool) -> None:
        requests = self._count(topic)
        self._requests[topic] = requests.heard(subscription, time.monotonic(), is_stop=message.data)
        self._changed()

    def _count(self, topic: str) -> StopRequests:
        infos = self._node.get_publishers_info_by_topic(topic)
        publishers: Publishers = {bytes(info.endpoint_gid): full_name(info) for info in infos}
        self._requests[topic] = replace(self._requests[topic], publishers=publishers)
        return self._requests[topic]
