"""A topic for monitoring, on which only the newest message matters."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

from rclpy.duration import Duration
from rclpy.node import Node

from rkhs_ros.nodes.core.messages import LATCHED_QOS

PERIOD_S = 0.2  # between messages
LAST_MESSAGE_TIMEOUT_S = 0.5  # for subscribers to receive the last message before the node exits


class NewestTopic:
    """A transient-local topic with a limited rate, by default published only if there are subscribers.

    Owns the function that makes the newest message, until it is published.

    Args:
        node: the publishing node.
        kind: type of the messages.
        name: of the topic.
        period_s: least time between messages.
        always: publish without subscribers too. Otherwise a late subscriber waits while the node computes.
    """

    def __init__(self, node: Node, kind: Any, name: str, period_s: float = PERIOD_S, *, always: bool = False) -> None:
        self._publisher = node.create_publisher(kind, name, LATCHED_QOS)
        self._period_s = period_s
        self._always = always
        self._make: Callable[[], Any] | None = None
        self._due = 0.0  # monotonic time, seconds

    def offer(self, make: Callable[[], Any]) -> None:
        """Set the function that makes the next message; it replaces an unpublished one."""
        self._make = make

    def heartbeat(self) -> float:
        """Publish a due message; return the seconds until the next one may be due."""
        if self._make is None:
            return self._period_s
        now = time.monotonic()
        if now >= self._due:
            self._due = now + self._period_s
            self._publish()
        return self._due - now

    def close(self) -> None:
        """Publish the pending message, and wait until subscribers have received it."""
        self._publish()
        self._publisher.wait_for_all_acked(Duration(seconds=LAST_MESSAGE_TIMEOUT_S))

    def _publish(self) -> None:
        if self._make is not None and (self._always or self._publisher.get_subscription_count() > 0):
            make, self._make = self._make, None
            self._publisher.publish(make())
