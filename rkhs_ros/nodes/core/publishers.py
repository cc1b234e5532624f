"""Who publishes on a topic: on a topic of the lockstep one node alone should."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Iterable

from rclpy.node import Node
from rclpy.topic_endpoint_info import TopicEndpointInfo

from rkhs_ros.nodes.core.names import NODES

DIFFERENT_STAND_S = 0.5  # that nodes must be seen side by side: one that has just come may be without its name yet
SAME_STAND_S = 30.0  # the same of one name: a node that was killed is seen for some seconds more


def publishers(node: Node, topic: str) -> Counter[str]:
    """Return how many publishers each node has on a topic, by the nodes' full names, unknown ones marked."""
    infos = node.get_publishers_info_by_topic(topic)
    return Counter(_shown(full_name(info)) for info in infos)


def full_name(info: TopicEndpointInfo) -> str:
    """Return the full name of the node that an endpoint belongs to."""
    return f"{info.node_namespace.rstrip('/')}/{info.node_name}"


def listed(node: Node, topic: str) -> str:
    """Return in words who publishes on a topic."""
    names = publishers(node, topic).elements()
    return f"{node.resolve_topic_name(topic)}: {', '.join(sorted(names)) or 'nobody'}"


def _shown(name: str) -> str:
    return name if name.rpartition("/")[2] in NODES else f"{name} (unknown)"


class SinglePublishers:
    """Watches topics on which one node alone should publish.

    Owns since when each topic has had more than one publisher.

    Args:
        node: the node that looks.
        topics: that it hears.
    """

    def __init__(self, node: Node, topics: Iterable[str]) -> None:
        self._node = node
        self._crowded_since: dict[str, float | None] = dict.fromkeys(topics)

    def crowded(self) -> str:
        """Return which topics have more than one publisher, and whose; empty where none has."""
        return "; ".join(listed(self._node, topic) for topic in self._crowded_since if self._is_crowded(topic))

    def _is_crowded(self, topic: str) -> bool:
        found, now = publishers(self._node, topic), time.monotonic()
        since = self._crowded_since[topic] if found.total() > 1 else None
        if found.total() > 1 and since is None:
            since = now
        self._crowded_since[topic] = since
        stands = DIFFERENT_STAND_S if len(found) > 1 else SAME_STAND_S
        return since is not None and now - since > stands
