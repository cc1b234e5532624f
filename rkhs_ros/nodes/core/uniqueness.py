"""Uniqueness of node names: if two processes run a node of the same name, the newer one exits."""

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
AT_ONCE_S = 0.05  # if two processes started within this time of each other, the one with the smaller number stays
ANNOUNCE_PERIOD_S = 0.1  # between announcements while there is another process
LOG_PERIOD_S = 1.0  # between log lines
# Transient local, for nodes that start later. Each node publishes few messages; a whole run publishes many.
SENDER_QOS = QoSProfile(depth=8, durability=DurabilityPolicy.TRANSIENT_LOCAL)
RECEIVER_QOS = QoSProfile(depth=256, durability=DurabilityPolicy.TRANSIENT_LOCAL)


class Uniqueness:
    """Announces this process of a node, and detects others that run a node of the same name.

    Each process announces its age by the monotonic clock. Messages take time, so a received age is never too great: of
    two processes only the newer one can receive a greater age than its own, and it exits. It does so only while another
    node of its name is in the graph, so that messages of other nodes have no effect.

    Args:
        node: the node whose full name is announced.
        process: that it runs in.
        yields_s: seconds after the start during which the node may exit for an older one. A forged age must not stop a
            node that others depend on later.
    """

    def __init__(self, node: Node, process: Process, yields_s: float = inf) -> None:
        self.instance = process.number
        self._began = process.began
        self._node = node
        self._yields_until = time.monotonic() + yields_s
        self._is_younger = False  # than another of its name
        self._announce_at = inf  # monotonic time, seconds
        node.create_subscription(NodeInstance, TOPIC, self._hear, RECEIVER_QOS)
        self._publisher = node.create_publisher(NodeInstance, TOPIC, SENDER_QOS)
        self._announce()

    def stay(self) -> None:
        """Never exit because of a node of the same name from now on."""
        self._yields_until = -inf

    def check(self) -> None:
        """Evaluate the received announcements; call it between messages, because callbacks must not raise.

        Raises:
            PeerError: an older node of this name is already running.
        """
        now = time.monotonic()
        if not self._is_younger and now < self._announce_at:
            return
        is_alone = self._namesakes() < 2
        if self._is_younger and not is_alone and now < self._yields_until:
            raise PeerError(
                f"expected one {self._node.get_name()} node, got an older one that is already running; "
                "set ROS_DOMAIN_ID to separate runs"
            )
        self._is_younger, self._announce_at = False, inf
        if not is_alone:
            self._announce()

    @property
    def _name(self) -> str:
        return str(self._node.get_fully_qualified_name())

    @property
    def _age(self) -> float:
        return time.monotonic() - self._began

    def _namesakes(self) -> int:
        """Return how many nodes of this name publish on the topic, including this one."""
        speakers = self._node.get_publishers_info_by_topic(TOPIC)
        return sum(full_name(each) == self._name for each in speakers)

    def _announce(self) -> None:
        self._publisher.publish(NodeInstance(node=self._name, instance=self.instance, age=self._age))

    def _hear(self, message: NodeInstance) -> None:
        """Compare the ages of both processes; ignore announcements of this process itself."""
        if message.node != self._name:
            return
        older = message.age - self._age
        order = (message.instance > self.instance) - (message.instance < self.instance)
        self._is_younger |= older > order * AT_ONCE_S
        self._announce_at = min(self._announce_at, time.monotonic() + ANNOUNCE_PERIOD_S)
        if older < -LOG_PERIOD_S and message.instance != self.instance:
            self._node.get_logger().warning(
                f"another {self._node.get_name()} node was started; the newer one exits",
                throttle_duration_sec=LOG_PERIOD_S,
            )
