"""Uniqueness: of two processes that run a node of the same name, the later one ends."""

from __future__ import annotations

from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile

from rkhs_interfaces.msg import NodeInstance
from rkhs_ros.nodes.spin import PeerError

TOPIC = "/rkhs/instances"
LOG_PERIOD_S = 1.0  # between lines in the log
# Latched, so that a node is heard, and answered, by one that it has not met yet: of each node few messages, of all
# nodes of a run many.
SENDER_QOS = QoSProfile(depth=8, durability=DurabilityPolicy.TRANSIENT_LOCAL)
HEARER_QOS = QoSProfile(depth=256, durability=DurabilityPolicy.TRANSIENT_LOCAL)


class Uniqueness:
    """Announces this process of a node, and hears of others that run a node of the same name.

    Owns the instance: a number that names this process among all that have the node's name, greater than those of
    processes before it. An earlier process is believed in if it answers to this number, and a node of its name is
    there to have said it: what is left of one that died ends nobody, nor do the messages of others.

    Args:
        node: the node, of which the full name is announced.
        instance: that number.
    """

    def __init__(self, node: Node, instance: int) -> None:
        self.instance = instance
        self._node = node
        self._is_answered = False  # by a process that was there before
        node.create_subscription(NodeInstance, TOPIC, self._hear, HEARER_QOS)
        self._publisher = node.create_publisher(NodeInstance, TOPIC, SENDER_QOS)
        self._say(answers=0)

    def check(self) -> None:
        """Look at what was heard; called between messages, since an error must not be raised while one is handled.

        Raises:
            PeerError: a node of this name was there before.
        """
        if self._is_answered and self._namesakes() > 1:
            raise PeerError(
                f"expected one {self._node.get_name()} node, got another that was there before; "
                "set ROS_DOMAIN_ID to keep runs apart"
            )

    @property
    def _name(self) -> str:
        return str(self._node.get_fully_qualified_name())

    def _namesakes(self) -> int:
        """Return how many nodes of this name speak on the topic, this one among them."""
        speakers = self._node.get_publishers_info_by_topic(TOPIC)
        return sum(f"{each.node_namespace.rstrip('/')}/{each.node_name}" == self._name for each in speakers)

    def _say(self, answers: int) -> None:
        self._publisher.publish(NodeInstance(node=self._name, instance=self.instance, answers=answers))

    def _hear(self, message: NodeInstance) -> None:
        if message.node != self._name:
            return
        if message.instance < self.instance:
            self._is_answered |= message.answers == self.instance
        elif message.instance > self.instance:
            self._say(answers=message.instance)
            self._node.get_logger().warning(
                f"another {self._node.get_name()} node was started; it is told to end",
                throttle_duration_sec=LOG_PERIOD_S,
            )
