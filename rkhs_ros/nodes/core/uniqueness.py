"""Uniqueness: of two processes that run a node of the same name, the younger one ends."""

from __future__ import annotations

import time
from math import inf

from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile

from rkhs_interfaces.msg import NodeInstance
from rkhs_ros.nodes.core.parameters import Process
from rkhs_ros.nodes.core.publishers import full_name
from rkhs_ros.nodes.core.spin import PeerError

TOPIC = "/rkhs/instances"
AT_ONCE_S = 0.05  # two processes that began within this time of each other: the one with the smaller number stays
SAY_PERIOD_S = 0.1  # between announcements while there is another process
LOG_PERIOD_S = 1.0  # between lines in the log
# Latched, so that a node is heard by one that it has not met yet: of each node few messages, of all of a run many.
SENDER_QOS = QoSProfile(depth=8, durability=DurabilityPolicy.TRANSIENT_LOCAL)
HEARER_QOS = QoSProfile(depth=256, durability=DurabilityPolicy.TRANSIENT_LOCAL)


class Uniqueness:
    """Announces this process of a node, and hears of others that run a node of the same name.

    Each says how old it is, by no clock that can be set. A message takes time, so an age that is heard is never too
    great: of two processes only the younger one can hear of a greater age than its own, and it ends. It believes only
    while a node of its name is there to have said it: the messages of others end nobody.

    Args:
        node: the node, of which the full name is announced.
        process: that it runs in.
        yields_s: seconds for which it may end for an older one, which it should have met by then. An age can be lied
            about, so what others depend on should not yield for longer.
    """

    def __init__(self, node: Node, process: Process, yields_s: float = inf) -> None:
        self.instance = process.number
        self._began = process.began
        self._node = node
        self._yields_until = time.monotonic() + yields_s
        self._is_younger = False  # than another of its name
        self._say_at = inf  # monotonic time, seconds
        node.create_subscription(NodeInstance, TOPIC, self._hear, HEARER_QOS)
        self._publisher = node.create_publisher(NodeInstance, TOPIC, SENDER_QOS)
        self._say()

    def stay(self) -> None:
        """End for no other process from now on."""
        self._yields_until = -inf

    def check(self) -> None:
        """Look at what was heard; called between messages, since an error must not be raised while one is handled.

        Raises:
            PeerError: a node of this name was there before.
        """
        now = time.monotonic()
        if not self._is_younger and now < self._say_at:
            return
        is_alone = self._namesakes() < 2
        if self._is_younger and not is_alone and now < self._yields_until:
            raise PeerError(
                f"expected one {self._node.get_name()} node, got another that was there before; "
                "set ROS_DOMAIN_ID to keep runs apart"
            )
        self._is_younger, self._say_at = False, inf
        if not is_alone:
            self._say()

    @property
    def _name(self) -> str:
        return str(self._node.get_fully_qualified_name())

    @property
    def _age(self) -> float:
        return time.monotonic() - self._began

    def _namesakes(self) -> int:
        """Return how many nodes of this name speak on the topic, this one among them."""
        speakers = self._node.get_publishers_info_by_topic(TOPIC)
        return sum(full_name(each) == self._name for each in speakers)

    def _say(self) -> None:
        self._publisher.publish(NodeInstance(node=self._name, instance=self.instance, age=self._age))

    def _hear(self, message: NodeInstance) -> None:
        """Compare ages; what this process said itself is heard, too, and makes no difference."""
        if message.node != self._name:
            return
        older = message.age - self._age
        order = (message.instance > self.instance) - (message.instance < self.instance)
        self._is_younger |= older > order * AT_ONCE_S
        self._say_at = min(self._say_at, time.monotonic() + SAY_PERIOD_S)
        if older < -LOG_PERIOD_S and message.instance != self.instance:
            self._node.get_logger().warning(
                f"another {self._node.get_name()} node was started; the younger one is to end",
                throttle_duration_sec=LOG_PERIOD_S,
            )
