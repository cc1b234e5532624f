"""Sources of sensor messages: their state and rate, and alternative topics if a source is silent."""

import time
from collections import deque

from rclpy.node import Node

from rkhs_ros.nodes.core.publishers import full_name

MESSAGES = 50  # over which the rate is averaged
SILENT_S = 1.0  # least time without a message after which a source is silent
OBSTACLE = "robot/obstacle"  # topic on which the robot node reports unusable sensors to the gate
PREFIX = "source "  # of the diagnostics keys of sources


class Source:
    """A topic of sensor messages.

    Owns the arrival times of its newest messages.

    Args:
        node: the subscribing node.
        topic: its name.
        kind: name of its message type.
        stale_after: seconds after which a message is stale.
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
        """Return the state of the source in one line.

        Args:
            flaw: error of its newest message; empty if there is none.
        """
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
