"""Conversions between a gate's values and messages: of commands, joints, reports and the hardware."""

from __future__ import annotations

import time
from collections.abc import Sequence
from typing import Any

import numpy as np
from builtin_interfaces.msg import Time as Stamp
from geometry_msgs.msg import Twist, TwistStamped
from rclpy.duration import Duration
from rclpy.time import Time
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

import rkhs_interfaces.msg as msg
from rkhs_ros.nodes.core.clocks import now_by_both_clocks
from rkhs_ros.policies.messages import doubles
from rkhs_ros.rkhs.kernels import Array
from rkhs_ros.robot.gate_settings import FLOATS, TRAJECTORY, TWIST, TWIST_STAMPED, GateSettings
from rkhs_ros.robot.gate_state import Command, CommandReport, Gate
from rkhs_ros.robot.limits import Limits, Sensed
from rkhs_ros.robot.motion import Setpoint, braking
from rkhs_ros.robot.sensors import missing_joints

MOST_POINTS = 10  # of a trajectory, which is sent every period
TYPES = {FLOATS: Float64MultiArray, TRAJECTORY: JointTrajectory, TWIST: Twist, TWIST_STAMPED: TwistStamped}


def seconds_of(stamp: Stamp) -> float:
    """Return the time of a stamp by the system's clock on the monotonic one, in seconds.

    That is the gate's, which no correction of the system's clock moves. However busy the machine is, of two stamps
    the later one stays so: both clocks are read at once, not one when the message came and the other when it is read.
    """
    now, now_ns = now_by_both_clocks()
    return now - 1e-9 * (now_ns - (stamp.sec * 1_000_000_000 + stamp.nanosec))


def command_of(message: msg.Command) -> Command:
    """Return the command that a message carries."""
    values = None if message.hold else np.array(message.values, dtype=np.float64)
    return Command(message.instance, message.number, seconds_of(message.stamp), values)


class JointStates:
    """Picks the joints of a gate out of messages.

    Owns where they were found last.

    Args:
        joints: their names.
    """

    def __init__(self, joints: Sequence[str]) -> None:
        self._joints = list(joints)
        self._names: list[str] = []
        self._places = np.zeros(0, dtype=np.intp)

    def sensed_of(self, message: JointState) -> Sensed:
        """Return what a message tells of the joints, nan for what it does not tell.

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
    """Return what the gate publishes of a command."""
    return msg.GateReport(
        instance=command.instance,
        number=command.number,
        stamp=_stamp(),
        asked=command.values,
        executed=doubles(report.executed),
        flags=int(report.flags),
    )


def state_message(state: Gate) -> msg.GateState:
    """Return what the gate publishes of itself."""
    return msg.GateState(state=str(state.mode), reason=state.reason, **vars(state.counts))


def hardware_message(settings: GateSettings, limits: Limits, motion: Setpoint) -> Any:
    """Return an output as the message that the hardware takes."""
    if settings.command.type == FLOATS:
        return Float64MultiArray(data=doubles(motion.value))
    if settings.command.type == TRAJECTORY:
        return _trajectory(settings, limits, motion)
    twist = _twist(settings.joints, motion.value)
    return twist if settings.command.type == TWIST else _stamped(twist, settings.command.frame)


def _trajectory(settings: GateSettings, limits: Limits, motion: Setpoint) -> JointTrajectory:
    """Return the next positions and how they come to rest, which is what happens where no further message comes."""
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
