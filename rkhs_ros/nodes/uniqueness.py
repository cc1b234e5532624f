"""Uniqueness: of two processes that run a node of the same name, the later one ends."""

from __future__ import annotations

from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile

from rkhs_interfaces.msg import NodeInstance
from rkhs_ros.nodes.spin import PeerError

TOPIC = "/rkhs/instances"
# Latched, so that a node that starts hears at once who is there: of each node one message, of all nodes of a run many.
SENDER_QOS = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
HEARER_QOS = QoSProfile(depth=256, durability=DurabilityPolicy.TRANSIENT_LOCAL)


class Uniqueness:
    """Announces this process of a node, and hears of others that run a node of the same name.

    Owns the instance: a number that names this process among all that have the node's name, greater than those of
    processes before it.

    Args:
        node: the node, of which the full name is announced.
        instance: that number.
    """

    def __init__(self, node: Node, instance: int) -> None:
        self.instance = instance
        self._node = node
        self._twins: list[int] = []  # instances heard since the last check
        node.create_subscription(NodeInstance, TOPIC, self._hear, HEARER_QOS)
        self._announcements = node.create_publisher(NodeInstance, TOPIC, SENDER_QOS)
        self._announcements.publish(NodeInstance(node=self._name, instance=self.instance))

    def check(self) -> None:
        """Look at what was heard; called between messages, since an error must not be raised while one is handled.

        Raises:
            PeerError: a node of this name was there before.
        """
        twins, self._twins = self._twins, []
        if not twins:
            return
        name = self._node.get_name()
        if min(twins) < self.instance:
            raise PeerError(
                f"expected one {name} node, got another that was there before; set ROS_DOMAIN_ID to keep runs apart"
            )
        self._node.get_logger().warning(f"another {name} node was started; it is told to end")

    @property
    def _name(self) -> str:
        return str(self._node.get_fully_qualified_name())

    def _hear(self, message: NodeInstance) -> None:
        if message.node == self._name and message.instance != self.instance:
            self._twins.append(message.instance)
