"""What a node says of itself on /diagnostics, and how it learns that there is another one of its name."""

from __future__ import annotations

import re
import time
from collections.abc import Callable, Mapping

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile

from rkhs_ros.nodes.spin import PeerError

PERIOD = 1.0  # seconds from one report to the next
QUIET = 1.0  # seconds between lines in the log
INSTANCE = re.compile(r"\d{1,20}")
# Latched, so that a node that starts hears at once who is there.
HEALTH_QOS = QoSProfile(depth=16, durability=DurabilityPolicy.TRANSIENT_LOCAL)


class Health:
    """A node's reports of how it fares.

    Owns the numbers of messages refused or passed over and of steps made, and the instance: a number that names this
    process among all that have the node's name, greater than those before it. Of two that live at the same time the
    later one ends.

    Args:
        node: the node, of which the full name is reported.
        restarts: how often the node was started again.
        report: returns what else is to be reported.
    """

    def __init__(self, node: Node, restarts: int, report: Callable[[], Mapping[str, object]]) -> None:
        self.instance = time.time_ns()
        self.refusals = 0
        self.passed_over = 0
        self.last_refusal = ""
        self.steps = 0
        self._node = node
        self._restarts = restarts
        self._report = report
        self._refusals_reported = 0
        self._twin: int | None = None
        self._due = self._since = time.monotonic()
        self._steps_since = 0
        self._reports = node.create_publisher(DiagnosticArray, "/diagnostics", HEALTH_QOS)
        node.create_subscription(DiagnosticArray, "/diagnostics", self._hear, HEALTH_QOS)

    def refuse(self, reason: str) -> None:
        """Count a message that was refused, and log why."""
        self.refusals += 1
        self.last_refusal = reason
        self._node.get_logger().warning(f"refused {reason}", throttle_duration_sec=QUIET)

    def pass_over(self, reason: str) -> None:
        """Count a message that came late, twice or for another, as some do wherever messages are lost."""
        self.passed_over += 1
        self.last_refusal = reason

    def look(self) -> float:
        """Report once a second; return the seconds until the next report.

        Raises:
            PeerError: a node of this name was there before.
        """
        if self._twin is not None:
            self._meet(self._twin)
        now = time.monotonic()
        if now >= self._due:
            self._reports.publish(self._message(now))
            self._due = now + PERIOD
        return self._due - now

    def _meet(self, twin: int) -> None:
        self._twin = None
        name = self._node.get_name()
        if twin < self.instance:
            raise PeerError(
                f"expected one {name} node, got another that was there before; set ROS_DOMAIN_ID to keep runs apart"
            )
        self._node.get_logger().warning(f"another {name} node was started; it is told to end")

    def _hear(self, message: DiagnosticArray) -> None:
        for status in message.status:
            other = status.hardware_id
            if status.name == self._name and INSTANCE.fullmatch(other) and int(other) != self.instance:
                self._twin = int(other)

    @property
    def _name(self) -> str:
        return str(self._node.get_fully_qualified_name())

    def _message(self, now: float) -> DiagnosticArray:
        refused = self.refusals > self._refusals_reported
        rate = (self.steps - self._steps_since) / max(now - self._since, 1e-9)
        self._refusals_reported, self._steps_since, self._since = self.refusals, self.steps, now
        values = {
            **self._report(),
            "steps per second": f"{rate:.0f}",
            "refusals": self.refusals,
            "passed over": self.passed_over,
            "last refusal": self.last_refusal,
            "restarts": self._restarts,
        }
        message = DiagnosticArray()
        message.header.stamp = self._node.get_clock().now().to_msg()
        message.status = [
            DiagnosticStatus(
                level=DiagnosticStatus.WARN if refused else DiagnosticStatus.OK,
                name=self._name,
                message="refused a message" if refused else "well",
                hardware_id=str(self.instance),
                values=[KeyValue(key=key, value=str(value)) for key, value in values.items()],
            )
        ]
        return message
