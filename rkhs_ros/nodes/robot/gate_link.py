"""The robot node's client of the gate, and of a simulated robot behind it."""

import time
from collections.abc import Callable
from math import inf

import numpy as np
from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.duration import Duration
from rclpy.node import Node
from std_srvs.srv import Trigger

from rkhs_interfaces.msg import Command, GateReport, GateState
from rkhs_ros.base.validation import truncated
from rkhs_ros.nodes.core.messages import LATCHED_QOS, LOCKSTEP_QOS
from rkhs_ros.policies.messages import doubles
from rkhs_ros.rkhs.kernels import Array
from rkhs_ros.robot.gate_state import STOP_REQUESTED

RETRY_S = 1.0  # between attempts to end a protective stop
LAST_COMMAND_TIMEOUT_S = 0.5  # for the gate to receive the last command before the node exits


class GateLink:
    """The robot node's client of the gate, and of a simulated robot behind it.

    Owns the numbers of this process and of its commands, and the last reported states of gate and robot.
    """

    def __init__(
        self, node: Node, timeout: float, report: Callable[[int, Array, int], None], *, simulated: bool
    ) -> None:
        self.number = 0
        self._node = node
        self._instance = time.time_ns()  # of two processes, the newer one has a greater number
        self._report = report
        self._state: GateState | None = None
        self._timeout = timeout
        self._unanswered_since = inf  # monotonic time of the first unreported command, seconds
        self._commands = node.create_publisher(Command, "command", LOCKSTEP_QOS)
        node.create_subscription(GateReport, "gate/report", self._hear_report, LOCKSTEP_QOS)
        node.create_subscription(GateState, "gate/state", self._hear_state, LATCHED_QOS)
        self._simulated = simulated
        self._protection = DiagnosticStatus()
        self._asked_at = 0.0  # monotonic time of the last attempt to end a protective stop, seconds
        if simulated:
            self._reset = node.create_client(Trigger, "simulated_robot/reset_protective_stop")
            violations = "simulated_robot/violations"
            node.create_subscription(DiagnosticStatus, violations, self._hear_violations, LATCHED_QOS)

    def send(self, values: Array, stamp: int) -> int:
        """Send a command based on an observation of the time `stamp`, in nanoseconds; return its number."""
        self.number += 1
        self._unanswered_since = min(self._unanswered_since, time.monotonic())
        self._publish(stamp, values=doubles(values))
        return self.number

    def hold(self) -> None:
        """Command the robot to come to rest and hold."""
        self.number += 1
        self._publish(time.time_ns(), hold=True)

    def obstacle(self) -> str:
        """Return why the robot cannot be moved; empty if it can."""
        if self._state is None:
            return "no gate is running"
        if self._is_silent:
            return f"the gate did not report a command within {self._timeout:g} s (stale_after)"
        if self._state.state == GateState.DISARMED:
            return "the gate is not armed" + f" ({truncated(self._state.reason)})" * bool(self._state.reason)
        if self._state.state == GateState.STOPPED:
            return f"the gate stopped the robot ({truncated(self._state.reason)})"
        if self._protection.level == DiagnosticStatus.ERROR:
            return f"the simulated robot made a protective stop ({truncated(self._protection.message)})"
        return ""

    @property
    def _is_silent(self) -> bool:
        return time.monotonic() - self._unanswered_since > self._timeout

    def removes_obstacles(self, now: float) -> bool:
        """End a protective stop; return whether obstacles go by themselves: of simulated robots, unless stopped."""
        if not self._simulated or (self._state is not None and self._state.reason.startswith(STOP_REQUESTED)):
            return False
        is_stopped = self._protection.level == DiagnosticStatus.ERROR
        if is_stopped and now >= self._asked_at + RETRY_S and self._reset.service_is_ready():
            self._asked_at = now
            self._reset.call_async(Trigger.Request())
        return True

    @property
    def remedy(self) -> str:
        """What the operator has to do about an obstacle."""
        service = self._node.resolve_service_name("gate/arm")
        call = f"rkhs robot arm FOLDER, or ros2 service call {service} std_srvs/srv/Trigger"
        arm = f"make sure that the robot may move, then run: {call}"
        is_running = self._state is not None and not self._is_silent
        return arm if is_running else f"start it, {arm}"

    def close(self) -> None:
        """Command the robot to hold, and wait until the gate has received the command."""
        self.hold()
        self._commands.wait_for_all_acked(Duration(seconds=LAST_COMMAND_TIMEOUT_S))

    def _publish(self, stamp: int, **content: object) -> None:
        seconds, nanoseconds = divmod(stamp, 10**9)
        time_stamp = Time(sec=seconds, nanosec=nanoseconds)
        self._commands.publish(Command(instance=self._instance, number=self.number, stamp=time_stamp, **content))

    def _hear_report(self, message: GateReport) -> None:
        if message.instance == self._instance:
            self._unanswered_since = inf
            self._report(message.number, np.array(message.executed), message.flags)

    def _hear_state(self, message: GateState) -> None:
        self._state, self._unanswered_since = message, inf

    def _hear_violations(self, message: DiagnosticStatus) -> None:
        self._protection = message
