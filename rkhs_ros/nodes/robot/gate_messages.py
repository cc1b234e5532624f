"""Conversions between a gate's values and messages: commands, joint states, reports and outputs."""

import time
from collections.abc import Sequence
from typing import Any

import numpy as np
from builtin_interfaces.msg import Time as Stamp
from geometry_msgs.msg import Twist, TwistStamped
from rclpy.duration import Duration
from rclpy.time import Time
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64, Float64MultiArray
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

import rkhs_interfaces.msg as msg
from rkhs_ros.nodes.core.messages import now_by_both_clocks
from rkhs_ros.policies.messages import doubles
from rkhs_ros.rkhs.kernels import Array
from rkhs_ros.robot.gate_settings import FLOAT, FLOATS, TRAJECTORY, TWIST, TWIST_STAMPED, GateSettings
from rkhs_ros.robot.gate_state import Command, CommandReport, Gate
from rkhs_ros.robot.limits import Limits, Sensed
from rkhs_ros.robot.motion import Setpoint, braking
from rkhs_ros.robot.sensors import missing_joints

MOST_POINTS = 10  # in a trajectory message; one is sent every period
TYPES = {
    FLOATS: Float64MultiArray,
    FLOAT: Float64,
    TRAJECTORY: JointTrajectory,
    TWIST: Twist,
    TWIST_STAMPED: TwistStamped,
}


def seconds_of(stamp: Stamp) -> float:
    """Convert a stamp of the system clock to the monotonic clock, in seconds.

    The gate uses the monotonic clock, which corrections of the system clock do not affect. The order of stamps is
    preserved even on a busy machine, because both clocks are read at once.
    """
    now, now_ns = now_by_both_clocks()
    return now - 1e-9 * (now_ns - (stamp.sec * 1_000_000_000 + stamp.nanosec))


def command_of(message: msg.Command) -> Command:
    """Return the command in a message."""
    values = None if message.hold else np.array(message.values, dtype=np.float64)
    return Command(message.instance, message.number, seconds_of(message.stamp), values)


class JointStates:
    """Extracts the joints of a gate from JointState messages.

    Owns the positions of the joints in the last message.
    """

    def __init__(self, joints: Sequence[str]) -> None:
        self._joints = list(joints)
        self._names: list[str] = []
        self._places = np.zeros(0, dtype=np.intp)

    def sensed_of(self, message: JointState) -> Sensed:
        """Return the state of the joints in a message; fields that it omits are nan.

        Raises:
            ValueError: a joint is missing.
        """
        if message.name != self._names:
            if missing := missing_joints(self._joints, message.name):
                raise ValueError(missing)
            self._names = list(message.name)
            self._places = np.array([self._names.index(joint) for joint in self._joints])
        fields = (self._picked(values) for values in (message.position, message.velocity, message.effort))
        return Sensed(seconds_of(message.header.stamp), *fields)

    def _picked(self, values: Any) -> Array:
        if len(values) != len(self._names):
            return np.full(len(self._joints), np.nan)
        return np.array(values, dtype=np.float64)[self._places]


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


def state_message(state: Gate) -> msg.GateState:
    """Return the gate's state message."""
    return msg.GateState(state=str(state.mode), reason=state.reason, **vars(state.counts))


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
        for seconds, values in braking(limits, settings.period, motion, MOST_POINTS)
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
