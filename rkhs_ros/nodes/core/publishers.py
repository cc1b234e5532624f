"""The publishers and subscribers of topics, and sources of sensor messages."""

import time
from collections import deque
from collections.abc import Iterable

from rclpy.node import Node
from rclpy.topic_endpoint_info import TopicEndpointInfo

UNKNOWN = "_NODE_NAME_UNKNOWN_"  # rmw's name of a node whose name is not known yet
MESSAGES = 50  # over which the rate of a source is averaged
SILENT_S = 1.0  # least time without a message after which a source is silent
OBSTACLE = "robot/obstacle"  # topic on which the robot node reports unusable sensors to the gate
PREFIX = "source "  # of the diagnostics keys of sources


def full_name(info: TopicEndpointInfo) -> str:
    """Return the full name of the node that an endpoint belongs to, as far as it is known."""
    return "an unknown node" if info.node_name == UNKNOWN else f"{info.node_namespace.rstrip('/')}/{info.node_name}"


def listed(node: Node, topic: str) -> str:
    """Return a topic and the nodes that publish on it, as text."""
    names = sorted(map(full_name, node.get_publishers_info_by_topic(topic)))
    return f"{node.resolve_topic_name(topic)}: {', '.join(names) or 'no publishers'}"


def rivals(node: Node, topics: Iterable[str]) -> str:
    """Return the topics on which nodes of different names publish, with the nodes, as far as known; empty if none."""
    names = {t: {full_name(i) for i in node.get_publishers_info_by_topic(t) if i.node_name != UNKNOWN} for t in topics}
    return "; ".join(listed(node, topic) for topic in names if len(names[topic]) > 1)


def is_answered(node: Node, topic: str, answers: str) -> bool:
    """Return whether a node subscribes to one topic of this node and publishes the other one.

    Other subscribers, such as recorders, do not answer. A node that this process has discovered receives its messages.
    """
    subscribers = {full_name(info) for info in node.get_subscriptions_info_by_topic(topic) if info.node_name != UNKNOWN}
    return not subscribers.isdisjoint(full_name(info) for info in node.get_publishers_info_by_topic(answers))


class Source:
    """A topic of sensor messages.

    Owns the arrival times of its newest messages.
    """

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
        topic = self._node.resolve_topic_name(self._topic)
        if not self._times:
            return f"{topic}: no messages, {self._published()}; topics of {self._kind}: {self._alternatives()}"
        seconds = self._times[-1] - self._times[0]
        rate = (len(self._times) - 1) / seconds if seconds else 0.0
        age = time.monotonic() - self._times[-1]
        how = "silent" if self.is_silent else "received"
        infos = self._node.get_publishers_info_by_topic(self._topic)
        several = f"; {len(infos)} publishers: {', '.join(sorted(map(full_name, infos)))}" if len(infos) > 1 else ""
        return f"{topic}: {how}, {rate:.3g} Hz, last {age:.2f} s ago{several}" + f"; {flaw}" * bool(flaw)

    def _published(self) -> str:
        infos = self._node.get_publishers_info_by_topic(self._topic)
        whose = sorted({f"{full_name(info)} as {info.topic_type}" for info in infos})
        return f"published by {', '.join(whose)}" if whose else "no publishers"

    def _alternatives(self) -> str:
        topics = [topic for topic, kinds in self._node.get_topic_names_and_types() if self._kind in kinds]
        return ", ".join(filter(self._is_published, topics)) or "none"

    def _is_published(self, topic: str) -> bool:
        return any(info.topic_type == self._kind for info in self._node.get_publishers_info_by_topic(topic))
