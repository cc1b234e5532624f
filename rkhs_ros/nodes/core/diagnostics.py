"""Diagnostics: a node's status reports on /diagnostics, and the state of the topics that it reads."""

import socket
import time
from collections import deque
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.qos import QoSProfile
from rclpy.topic_endpoint_info import TopicEndpointInfo

TOPIC = "/diagnostics"
DIAGNOSTICS_QOS = QoSProfile(depth=10)  # reliable and volatile, like all publishers of this topic
REPORT_PERIOD_S = 1.0
LOG_PERIOD_S = 1.0  # between log lines of refusals
LAST_REPORT_TIMEOUT_S = 0.5  # for subscribers to receive the report of an error before the node exits

UNCONNECTED = "not connected yet: "  # prefix of a refusal that ends once the nodes have discovered each other
UNKNOWN = "_NODE_NAME_UNKNOWN_"  # rmw's name of a node whose name is not known yet
MESSAGES = 50  # over which the rate of a source is averaged
SILENT_S = 1.0  # least time without a message after which a source is silent
OBSTACLE = "robot/obstacle"  # topic on which the robot node reports unusable sensors to the gate
PREFIX = "source "  # of the diagnostics keys of sources


class Diagnostics:
    """A node's status reports, once a second.

    Owns the numbers of refused and ignored messages and of steps, why the node is stuck or has stopped the robot, and
    what the operator has to do. `report` returns further values to report.
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
        now = time.monotonic()
        steps, seconds = self.steps - self._steps_reported, now - self._reported_at
        self._steps_reported, self._reported_at = self.steps, now
        return steps / max(seconds, 1e-9)


def full_name(info: TopicEndpointInfo) -> str:
    """Return the full name of the node that an endpoint belongs to, as far as it is known."""
    return "an unknown node" if info.node_name == UNKNOWN else f"{info.node_namespace.rstrip('/')}/{info.node_name}"


def listed(node: Node, topic: str) -> str:
    """Return a topic and the nodes that publish on it, as text."""
    names = sorted(map(full_name, node.get_publishers_info_by_topic(topic)))
    return f"{node.resolve_topic_name(topic)}: {', '.join(names) or 'no publishers'}"


def rivals(node: Node, topic: str) -> str:
    """Return a topic with its publishers if nodes of different names publish on it, as far as known; empty if not."""
    known = {full_name(each) for each in node.get_publishers_info_by_topic(topic) if each.node_name != UNKNOWN}
    return listed(node, topic) if len(known) > 1 else ""


def unconnected(node: Node, topic: str, answers: str) -> str:
    """Return an error message unless a node subscribes to one topic of this node and publishes the other one.

    Other subscribers, such as recorders, do not answer. A node that this process has discovered receives its messages.
    """
    subscribers = {full_name(info) for info in node.get_subscriptions_info_by_topic(topic) if info.node_name != UNKNOWN}
    answering = {full_name(info) for info in node.get_publishers_info_by_topic(answers)}
    return "" if subscribers & answering else f"{UNCONNECTED}no node answers {topic} by {answers}"


class Source:
    """A topic of sensor messages; owns the arrival times of its newest messages."""

    def __init__(self, node: Node, topic: str, kind: str, stale_after: float) -> None:
        self._node = node
        self._topic = topic
        self._kind = kind
        self._silent_after = max(stale_after, SILENT_S)
        self._times: deque[float] = deque(maxlen=MESSAGES)

    def hear(self) -> None:
        """Count a message."""
        self._times.append(time.monotonic())

    @property
    def is_silent(self) -> bool:
        """Whether no message has arrived recently, or ever."""
        return not self._times or time.monotonic() - self._times[-1] > self._silent_after

    def line(self, flaw: str = "") -> str:
        """Return the state of the source in one line."""
        topic, infos = self._node.resolve_topic_name(self._topic), self._node.get_publishers_info_by_topic(self._topic)
        if not self._times:
            whose = ", ".join(sorted({f"{full_name(info)} as {info.topic_type}" for info in infos}))
            published = f"published by {whose}" if whose else "no publishers"
            return f"{topic}: no messages, {published}; topics of {self._kind}: {self._alternatives()}"
        seconds = self._times[-1] - self._times[0]
        rate = (len(self._times) - 1) / seconds if seconds else 0.0
        age = time.monotonic() - self._times[-1]
        how = "silent" if self.is_silent else "received"
        several = f"; {len(infos)} publishers: {', '.join(sorted(map(full_name, infos)))}" if len(infos) > 1 else ""
        return f"{topic}: {how}, {rate:.3g} Hz, last {age:.2f} s ago{several}" + f"; {flaw}" * bool(flaw)

    def _alternatives(self) -> str:
        """Return the topics on which a node publishes messages of this type."""
        topics = [topic for topic, kinds in self._node.get_topic_names_and_types() if self._kind in kinds]
        published = {t: {info.topic_type for info in self._node.get_publishers_info_by_topic(t)} for t in topics}
        return ", ".join(topic for topic in topics if self._kind in published[topic]) or "none"
