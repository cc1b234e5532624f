"""A topic for those who look on: of its messages the newest one counts."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

from rclpy.duration import Duration
from rclpy.node import Node

from rkhs_ros.nodes.core.messages import LATCHED_QOS

PERIOD_S = 0.2  # between messages
LAST_MESSAGE_TIMEOUT_S = 0.5  # for listeners to take the last message before the node ends


class NewestTopic:
    """A latched topic that is published on a few times a second at most, and not while nobody listens.

    Owns the newest message, as what makes it, until it is published; who comes later hears it then.

    Args:
        node: that publishes.
        kind: of the messages.
        name: of the topic.
        period_s: between messages.
        always: publish although nobody listens: a node that computes for long would let those wait who come meanwhile.
    """

    def __init__(self, node: Node, kind: Any, name: str, period_s: float = PERIOD_S, *, always: bool = False) -> None:
        self._publisher = node.create_publisher(kind, name, LATCHED_QOS)
        self._period_s = period_s
        self._always = always
        self._make: Callable[[], Any] | None = None
        self._due = 0.0  # monotonic time, seconds

    def offer(self, make: Callable[[], Any]) -> None:
        """Have what this makes published in place of all before, when it is due."""
        self._make = make

    def heartbeat(self) -> float:
        """Publish what is due; return the seconds until more may be."""
        if self._make is None:
            return self._period_s
        now = time.monotonic()
        if now >= self._due:
            self._due = now + self._period_s
            self._publish()
        return self._due - now

    def close(self) -> None:
        """Publish what was not yet, and wait until it is heard."""
        self._publish()
        self._publisher.wait_for_all_acked(Duration(seconds=LAST_MESSAGE_TIMEOUT_S))

    def _publish(self) -> None:
        if self._make is not None and (self._always or self._publisher.get_subscription_count() > 0):
            make, self._make = self._make, None
            self._publisher.publish(make())
