"""Diagnostics: a node's status reports on /diagnostics."""

import socket
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.qos import QoSProfile

TOPIC = "/diagnostics"
DIAGNOSTICS_QOS = QoSProfile(depth=10)  # reliable and volatile, like all publishers of this topic
REPORT_PERIOD_S = 1.0
LOG_PERIOD_S = 1.0  # between log lines of refusals
LAST_REPORT_TIMEOUT_S = 0.5  # for subscribers to receive the report of an error before the node exits


class Diagnostics:
    """A node's status reports, once a second.

    Owns the numbers of refused and ignored messages and of steps, why the node is stuck or has stopped the robot, and
    what the operator has to do.

    Args:
        report: returns further values to report.
    """

    def __init__(self, node: Node, report: Callable[[], Mapping[str, object]]) -> None:
        self.refusals = 0
        self.ignored = 0
        self.last_refusal = ""
        self.steps = 0
        self.stuck = ""  # why the node is stuck; empty if it is not
        self.stopped = ""  # why the node has stopped the robot; empty if it has not
        self.waiting = ""  # what the operator has to do; empty if nothing
        self._node = node
        self._report = report
        self._host = socket.gethostname()
        self._due = self._reported_at = time.monotonic()
        self._refusals_reported = self._steps_reported = 0
        self._reports = node.create_publisher(DiagnosticArray, TOPIC, DIAGNOSTICS_QOS)

    def refuse(self, reason: str) -> None:
        """Count a refused message, and log why."""
        self.refusals += 1
        self.last_refusal = reason
        self._node.get_logger().warning(f"refused {reason}", throttle_duration_sec=LOG_PERIOD_S)

    @contextmanager
    def accepting(self, response: Any, what: str) -> Iterator[None]:
        """Set a service's response to accepted, or to refused with the message of a ValueError or TypeError."""
        try:
            yield
            response.success = True
        except (ValueError, TypeError) as error:
            response.message = str(error)
            self.refuse(f"{what}: {error}")

    def skip(self, reason: str) -> None:
        """Count an ignored message: of an earlier batch or for another node."""
        self.ignored += 1
        self.last_refusal = reason

    def heartbeat(self) -> float:
        """Report once a second; return the seconds until the next report."""
        now = time.monotonic()
        if now >= self._due:
            self._publish(*self._state())
            self._due = now + REPORT_PERIOD_S
        return self._due - now

    @contextmanager
    def errors_reported(self) -> Iterator[None]:
        """Report the error that ends the node, if there is one."""
        try:
            yield
        except Exception as error:
            self._publish(DiagnosticStatus.ERROR, f"exits: {error}")
            self._reports.wait_for_all_acked(Duration(seconds=LAST_REPORT_TIMEOUT_S))
            raise

    def _state(self) -> tuple[bytes, str]:
        refused, self._refusals_reported = self.refusals > self._refusals_reported, self.refusals
        if self.stuck:
            return DiagnosticStatus.ERROR, f"stuck: {self.stuck}"
        if self.stopped:
            return DiagnosticStatus.ERROR, f"stopped: {self.stopped}"
        if self.waiting:
            return DiagnosticStatus.WARN, f"waiting: {self.waiting}"
        return (DiagnosticStatus.WARN, "refused a message") if refused else (DiagnosticStatus.OK, "ok")

    def _publish(self, level: bytes, text: str) -> None:
        status = DiagnosticStatus(
            level=level,
            name=str(self._node.get_fully_qualified_name()),
            message=text,
            hardware_id=self._host,
            values=[KeyValue(key=key, value=str(value)) for key, value in self._values().items()],
        )
        message = DiagnosticArray(status=[status])
        message.header.stamp = self._node.get_clock().now().to_msg()
        self._reports.publish(message)

    def _values(self) -> dict[str, object]:
        return {
            **self._report(),
            "steps per second": f"{self._rate():.0f}",
            "refusals": self.refusals,
            "ignored": self.ignored,
            "last refusal": self.last_refusal,
        }

    def _rate(self) -> float:
        """Return the steps per second since the last report."""
        now = time.monotonic()
        steps, seconds = self.steps - self._steps_reported, now - self._reported_at
        self._steps_reported, self._reported_at = self.steps, now
        return steps / max(seconds, 1e-9)
