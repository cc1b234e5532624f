"""The robot node's client of a simulated robot, which a run prepares automatically."""

from __future__ import annotations

from typing import Any

from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.node import Node
from std_srvs.srv import Trigger

from rkhs_ros.base.validation import truncated
from rkhs_ros.nodes.core.messages import LATCHED_QOS
from rkhs_ros.nodes.robot.gate_link import GateLink

RETRY_S = 1.0  # between attempts to arm the gate, or to end a protective stop
NAME = "simulated_robot"


class SimulatedRobotLink:
    """The robot node's client of a simulated robot.

    Arms its gate and ends its protective stops automatically, unless a stop was requested.

    Owns the robot's last report, and the time of the last attempt.

    Args:
        node: the robot node.
        gate: between the node and the robot.
    """

    def __init__(self, node: Node, gate: GateLink) -> None:
        self._node = node
        self._gate = gate
        self._report = DiagnosticStatus()
        self._asked_at = 0.0
        self._arm = node.create_client(Trigger, "gate/arm")
        self._reset = node.create_client(Trigger, f"{NAME}/reset_protective_stop")
        node.create_subscription(DiagnosticStatus, f"{NAME}/violations", self._hear_report, LATCHED_QOS)

    def obstacle(self) -> str:
        """Return the reason of the robot's protective stop; empty if there is none."""
        if self._report.level != DiagnosticStatus.ERROR:
            return ""
        return f"the simulated robot made a protective stop ({truncated(self._report.message)})"

    def make_ready(self, now: float) -> bool:
        """Prepare the robot to move; return whether this happens automatically.

        After a requested stop it does not: as on any robot, an operator has to arm the gate.
        """
        if self._gate.stop_was_requested:
            return False
        if now >= self._asked_at + RETRY_S and NAME in self._node.get_node_names():
            self._asked_at = now
            self._ask(self._reset, due=bool(self.obstacle()))
            self._ask(self._arm, due=self._gate.stands)
        return True

    def _ask(self, service: Any, *, due: bool) -> None:
        if due and service.service_is_ready():
            service.call_async(Trigger.Request())

    def _hear_report(self, message: DiagnosticStatus) -> None:
        self._report = message
