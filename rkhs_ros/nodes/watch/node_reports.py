"""The newest reports of all nodes: for ``rkhs status``, and in a thread for the page of a run."""

import time
from threading import Thread
from typing import Any

import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rclpy.context import Context
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node

from rkhs_interfaces.msg import GateState
from rkhs_ros.nodes.core.diagnostics import DIAGNOSTICS_QOS, REPORT_PERIOD_S, TOPIC
from rkhs_ros.nodes.core.messages import LATCHED_QOS
from rkhs_ros.nodes.core.transport import using_udp

LISTEN_S = 3 * REPORT_PERIOD_S  # without a report, after which a node counts as silent
OF_OURS = "ignored"  # key that all nodes of this project report
LEVELS = {DiagnosticStatus.OK: "ok", DiagnosticStatus.WARN: "warning"}
Statuses = dict[str, DiagnosticStatus]


class ReportListener(Node):
    """Subscribes to the status reports of nodes.

    Owns the newest report of each node with its arrival time, and the time of the last new node's appearance.
    """

    def __init__(self, name: str, context: Context | None = None) -> None:
        super().__init__(name, context=context)
        self.heard_new_at = time.monotonic()
        self._heard: dict[str, tuple[float, DiagnosticStatus]] = {}
        self.create_subscription(DiagnosticArray, TOPIC, self._hear, DIAGNOSTICS_QOS)

    @property
    def statuses(self) -> Statuses:
        """The newest report of each node, replaced by an error if the node has fallen silent."""
        now, heard = time.monotonic(), dict(self._heard)
        return {name: _silent(each, now - at) if now - at > LISTEN_S else each for name, (at, each) in heard.items()}

    def _hear(self, message: DiagnosticArray) -> None:
        now = time.monotonic()
        ours = {each.name: (now, each) for each in message.status if OF_OURS in values_of(each)}
        if ours.keys() - self._heard.keys():
            self.heard_new_at = now
        self._heard |= ours


class NodeReports:
    """Receives the reports of the nodes and of the gate in one ROS domain, in a thread, until it is closed."""

    def __init__(self, domain: int) -> None:
        self._context = Context()
        with using_udp():  # like the nodes that it listens to
            rclpy.init(args=[], context=self._context, domain_id=domain)
            self._node = ReportListener("page", self._context)
        self._gate: GateState | None = None
        self._node.create_subscription(GateState, "gate/state", self._hear_gate, LATCHED_QOS)
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self._node)
        self._thread = Thread(target=self._spin, daemon=True)
        self._thread.start()

    def nodes(self) -> list[tuple[str, str, str]]:
        """Return the name, the level ("ok", "warning" or "error") and the message of each node."""
        statuses = self._node.statuses
        return [(name, LEVELS.get(each.level, "error"), each.message) for name, each in sorted(statuses.items())]

    def gate(self) -> dict[str, Any] | None:
        """Return the fields of the gate's state by name; None without a gate."""
        fields = () if self._gate is None else self._gate.get_fields_and_field_types()
        return {name: getattr(self._gate, name) for name in fields} or None

    def close(self) -> None:
        """Leave the domain."""
        self._context.try_shutdown()
        self._thread.join()
        self._executor.shutdown()
        self._node.destroy_node()

    def _spin(self) -> None:
        try:
            self._executor.spin()
        except ExternalShutdownException:
            return

    def _hear_gate(self, message: GateState) -> None:
        self._gate = message


def values_of(status: DiagnosticStatus) -> dict[str, str]:
    """Return the values of a report by key."""
    return {value.key: value.value for value in status.values}


def _silent(status: DiagnosticStatus, seconds: float) -> DiagnosticStatus:
    message = f"silent: for {seconds:.0f} s"
    return DiagnosticStatus(name=status.name, level=DiagnosticStatus.ERROR, message=message, values=status.values)
