"""Sources of sensor messages: whether each is heard, how often, and what else there is if it is not."""

from __future__ import annotations

import time
from collections import deque

from rclpy.node import Node

from rkhs_ros.nodes.core.publishers import full_name

MESSAGES = 50  # of which a rate is the mean
SILENT_S = 1.0  # without a message, at least
OBSTACLE = "robot/obstacle"  # topic on which the robot node tells the gate which sensors cannot be used
PREFIX = "source "  # of the keys under which nodes report their sources


class Source:
    """A topic of sensor messages.

    Owns when its newest messages came.

    Args:
        node: that hears it.
        topic: its name.
        kind: name of the type of its messages.
        stale_after: seconds after which a message is too old.
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
        """Whether no message came for a while, or none at all."""
        return not self._times or time.monotonic() - self._times[-1] > self._silent_after

    def line(self, flaw: str = "") -> str:
        """Return in one line how the source fares.

        Args:
            flaw: what is wrong with its newest message; empty if nothing.
        """
        topic = self._node.resolve_topic_name(self._topic)
        if not self._times:
            return f"{topic} not heard, {self._published()}; topics of {self._kind}: {self._alternatives()}"
        seconds = self._times[-1] - self._times[0]
        rate = (len(self._times) - 1) / seconds if seconds else 0.0
        age = time.monotonic() - self._times[-1]
        how = "silent" if self.is_silent else "heard"
        return f"{topic} {how}, {rate:.3g} Hz, last {age:.2f} s ago" + f"; {flaw}" * bool(flaw)

    def _published(self) -> str:
        infos = self._node.get_publishers_info_by_topic(self._topic)
        whose = sorted({f"{full_name(info)} as {info.topic_type}" for info in infos})
        return f"published by {', '.join(whose) or 'nobody'}"

    def _alternatives(self) -> str:
        topics = [topic for topic, kinds in self._node.get_topic_names_and_types() if self._kind in kinds]
        return ", ".join(filter(self._is_published, topics)) or "none"

    def _is_published(self, topic: str) -> bool:
        return any(info.topic_type == self._kind for info in self._node.get_publishers_info_by_topic(topic))
