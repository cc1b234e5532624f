"""The topics on which other nodes request a stop."""

import time
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial

from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy
from std_msgs.msg import Bool

from rkhs_ros.nodes.core.publishers import full_name
from rkhs_ros.robot.gate_state import Publishers, StopRequests

# A transient-local subscription does not match a volatile publisher, nor a reliable one a best-effort one. For any
# publisher, one of these is the best match. They keep all messages, so that none replaces an unread request.
QOS = tuple(
    QoSProfile(history=HistoryPolicy.KEEP_ALL, reliability=reliability, durability=durability)
    for reliability, durability in (
        (ReliabilityPolicy.RELIABLE, DurabilityPolicy.TRANSIENT_LOCAL),
        (ReliabilityPolicy.RELIABLE, DurabilityPolicy.VOLATILE),
        (ReliabilityPolicy.BEST_EFFORT, DurabilityPolicy.VOLATILE),
    )
)


class StopTopics:
    """Subscriptions to std_msgs/Bool topics on which other nodes request a stop.

    Owns the requests of each topic.

    Args:
        timeouts: seconds of silence that mean stop, by topic; 0 for no timeout.
        changed: called after each message, so that the gate acts on every request, also on one that is withdrawn by the
            next message.
    """

    def __init__(self, node: Node, timeouts: Mapping[str, float], changed: Callable[[], None]) -> None:
        self._node = node
        self._changed = changed
        names = {node.resolve_topic_name(topic): timeout for topic, timeout in timeouts.items()}
        self._requests = {topic: StopRequests(topic, timeout) for topic, timeout in names.items()}
        for topic in names:
            for number, qos in enumerate(QOS):
                node.create_subscription(Bool, topic, partial(self._hear, topic, number), qos)

    def reason(self) -> str:
        """Return why the robot must stop; empty if it need not."""
        now = time.monotonic()
        for topic in self._requests:
            self._count(topic)
        return "; ".join(filter(None, (each.reason(now) for each in self._requests.values())))

    def drop_departed(self) -> None:
        """Remove requests of publishers that no longer exist; only an operator who arms the gate may do so."""
        for topic in self._requests:
            self._requests[topic] = self._count(topic).without_departed()

    def _hear(self, topic: str, subscription: int, message: Bool) -> None:
        requests = self._count(topic)
        self._requests[topic] = requests.heard(subscription, time.monotonic(), is_stop=message.data)
        self._changed()

    def _count(self, topic: str) -> StopRequests:
        """Update the publishers of a topic and return its requests."""
        infos = self._node.get_publishers_info_by_topic(topic)
        publishers: Publishers = {bytes(info.endpoint_gid): full_name(info) for info in infos}
        self._requests[topic] = replace(self._requests[topic], publishers=publishers)
        return self._requests[topic]
