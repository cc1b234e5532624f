"""The robot node's client of a simulated robot, which a run prepares automatically."""

from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.node import Node
from std_srvs.srv import Trigger

from rkhs_ros.base.validation import truncated
from rkhs_ros.nodes.core.messages import LATCHED_QOS
from rkhs_ros.nodes.robot.gate_link import GateLink

RETRY_S = 1.0  # between attempts to end a protective stop
PATIENCE_S = 5.0  # for the gate to arm itself; later, the node asks the operator to arm it
NAME = "simulated_robot"


class SimulatedRobotLink:
    """The robot node's client of a simulated robot.

    Ends its protective stops automatically, unless a stop was requested; its gate arms itself.

    Owns the robot's last report, and the times of the last attempt, of the last obstacle and of its beginning.

    Args:
        node: the robot node.
        gate: between the node and the robot.
    """

    def __init__(self, node: Node, gate: GateLink) -> None:
        self._node = node
        self._gate = gate
        self._report = DiagnosticStatus()
        self._asked_at = self._seen_at = self._since = 0.0
        self._reset = node.create_client(Trigger, f"{NAME}/reset_protective_stop")
        node.create_subscription(DiagnosticStatus, f"{NAME}/violations", self._hear_report, LATCHED_QOS)

    def obstacle(self) -> str:
        """Return the reason of the robot's protective stop; empty if there is none."""
        if self._report.level != DiagnosticStatus.ERROR:
            return ""
        return f"the simulated robot made a protective stop ({truncated(self._report.message)})"

    def make_ready(self, now: float) -> bool:
        """Prepare the robot to move; return whether this happens automatically.

        After a requested stop, or if the gate does not arm itself for some seconds, an operator has to arm it.

        Args:
            now: monotonic time of this call, seconds; it is repeated while there is an obstacle.
        """
        if self._gate.stop_was_requested:
            return False
        if now > self._seen_at + RETRY_S:
            self._since = now
        self._seen_at = now
        is_due = bool(self.obstacle()) and now >= self._asked_at + RETRY_S
        if is_due and NAME in self._node.get_node_names() and self._reset.service_is_ready():
            self._asked_at = now
            self._reset.call_async(Trigger.Request())
        return now < self._since + PATIENCE_S

    def _hear_report(self, message: DiagnosticStatus) -> None:
        self._report = message
