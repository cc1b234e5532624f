"""The publishers and subscribers of topics, and detection of a second publisher on a topic of the lockstep."""

import time
from collections import Counter
from collections.abc import Iterable

from rclpy.node import Node
from rclpy.topic_endpoint_info import TopicEndpointInfo

from rkhs_ros.nodes.core.names import NODES

DIFFERENT_STAND_S = 0.5  # before two nodes count as publishers: a new node may not have its name yet
UNKNOWN = "_NODE_NAME_UNKNOWN_"  # rmw's name of a node whose name is not known yet
SAME_STAND_S = 30.0  # the same for two nodes of one name: a killed node stays in the graph for some seconds


def publishers(node: Node, topic: str) -> Counter[str]:
    """Return the number of publishers per node on a topic, by full names; names of other projects are marked."""
    infos = node.get_publishers_info_by_topic(topic)
    return Counter(_shown(full_name(info)) for info in infos)


def full_name(info: TopicEndpointInfo) -> str:
    """Return the full name of the node that an endpoint belongs to, as far as it is known."""
    return "an unknown node" if info.node_name == UNKNOWN else f"{info.node_namespace.rstrip('/')}/{info.node_name}"


def listed(node: Node, topic: str) -> str:
    """Return a topic and the nodes that publish on it, as text."""
    names = publishers(node, topic).elements()
    return f"{node.resolve_topic_name(topic)}: {', '.join(sorted(names)) or 'no publishers'}"


def is_answered(node: Node, topic: str, answers: str) -> bool:
    """Return whether a node subscribes to one topic of this node and publishes the other one.

    Other subscribers, such as recorders, do not answer. A node that this process has discovered receives its messages.
    """
    subscribers = {full_name(info) for info in node.get_subscriptions_info_by_topic(topic) if info.node_name != UNKNOWN}
    return not subscribers.isdisjoint(full_name(info) for info in node.get_publishers_info_by_topic(answers))


def _shown(name: str) -> str:
    return name if name.rpartition("/")[2] in NODES else f"{name} (unknown)"


class SinglePublishers:
    """Checks that topics have a single publisher.

    Owns the time since which each topic has had more than one publisher.

    Args:
        node: the subscribing node.
        topics: that it subscribes to.
    """

    def __init__(self, node: Node, topics: Iterable[str]) -> None:
        self._node = node
        self._crowded_since: dict[str, float | None] = dict.fromkeys(topics)

    def crowded(self) -> str:
        """Return the topics with more than one publisher, with the publishers; empty if there are none."""
        return "; ".join(listed(self._node, topic) for topic in self._crowded_since if self._is_crowded(topic))

    def _is_crowded(self, topic: str) -> bool:
        found, now = publishers(self._node, topic), time.monotonic()
        since = self._crowded_since[topic] if found.total() > 1 else None
        if found.total() > 1 and since is None:
            since = now
        self._crowded_since[topic] = since
        stands = DIFFERENT_STAND_S if len(found) > 1 else SAME_STAND_S
        return since is not None and now - since > stands
