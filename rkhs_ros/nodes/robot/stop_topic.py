"""The topic on which others request a stop, heard with who says what.

Of ROS 2 Jazzy rclpy tells a callback no publisher, so messages are taken by rcl itself, as rclpy takes them.
"""

from __future__ import annotations

import ctypes
import time

from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.subscription import Subscription
from std_msgs.msg import Bool

from rkhs_ros.nodes.core.publishers import full_name
from rkhs_ros.robot.gate_state import STOP_REQUESTED
from rkhs_ros.robot.stops import StopRequest, Stops

DEPTH = 256  # messages between two looks, of all publishers together
# A latched subscription hears no publisher that is not, nor a reliable one that is not: whatever a publisher offers,
# one of these takes it at its best. What is heard twice counts once.
QOS = (
    QoSProfile(depth=DEPTH, durability=DurabilityPolicy.TRANSIENT_LOCAL),
    QoSProfile(depth=DEPTH),
    QoSProfile(depth=DEPTH, reliability=ReliabilityPolicy.BEST_EFFORT),
)
UNKNOWN = "_NODE_NAME_UNKNOWN_"  # as rmw says of a node that has not told its name yet
OK = 0  # RCL_RET_OK: a message was taken


class _MessageInfo(ctypes.Structure):
    """rmw_message_info_t of rmw/types.h, and room for what later versions may append."""

    _fields_ = (
        ("source_timestamp", ctypes.c_int64),
        ("received_timestamp", ctypes.c_int64),
        ("publication_sequence_number", ctypes.c_uint64),
        ("reception_sequence_number", ctypes.c_uint64),
        ("implementation_identifier", ctypes.c_char_p),
        ("publisher_gid", ctypes.c_uint8 * 16),
        ("from_intra_process", ctypes.c_bool),
        ("later", ctypes.c_uint8 * 64),
    )


class StopTopic:
    """Hears a topic of std_msgs/Bool with the publisher of each message.

    Owns what each publisher said last, the names of their nodes, and a node of its own for its subscriptions: an
    executor would take their messages.

    Args:
        node: that listens.
        topic: of the stops.
        timeout: seconds of silence that mean stop; 0 for none.
    """

    def __init__(self, node: Node, topic: str, timeout: float) -> None:
        self._stops = Stops(topic, timeout)
        self._names: dict[bytes, str] = {}
        self._topic = node.resolve_topic_name(topic)
        self._node = Node(
            f"{node.get_name()}_{topic}",
            namespace=node.get_namespace(),
            context=node.context,
            use_global_arguments=False,
            enable_rosout=False,
            start_parameter_services=False,
        )
        self._subscriptions = [self._node.create_subscription(Bool, self._topic, _no_callback, qos) for qos in QOS]
        self._take = ctypes.CDLL("librcl.so").rcl_take
        self._take.argtypes = (ctypes.c_void_p, ctypes.c_void_p, ctypes.POINTER(_MessageInfo), ctypes.c_void_p)

    def reason(self) -> str:
        """Take what came; return who requests a stop, empty if nobody."""
        full = [all(self._hear(subscription) for _ in range(DEPTH)) for subscription in self._subscriptions]
        if any(full):  # a request may have been dropped
            return (
                f"{STOP_REQUESTED} on the topic '{self._topic}', perhaps: {DEPTH} or more messages between two checks"
            )
        if not self._stops.requests.keys() <= self._names.keys():
            self._names |= self._present(named=True)
        return self._stops.reason(time.monotonic(), self._names)

    def drop_departed(self) -> None:
        """Forget publishers that are gone, at the word of a person who arms the gate."""
        self._stops = self._stops.without_departed(self._present())

    def _hear(self, subscription: Subscription) -> bool:
        """Take a message; return whether there was one."""
        data, info = ctypes.c_bool(), _MessageInfo()  # a std_msgs/Bool of C is one bool
        with subscription.handle:
            if self._take(subscription.handle.pointer, ctypes.byref(data), ctypes.byref(info), None) != OK:
                return False
        word = StopRequest(data.value, info.publication_sequence_number, time.monotonic())
        self._stops = self._stops.with_request(bytes(info.publisher_gid), word)
        return True

    def _present(self, *, named: bool = False) -> dict[bytes, str]:
        """Return the full name of each publisher's node, or of those alone that have told it already."""
        infos = self._node.get_publishers_info_by_topic(self._topic)
        return {
            bytes(info.endpoint_gid): full_name(info) for info in infos if not (named and info.node_name == UNKNOWN)
        }


def _no_callback(message: Bool) -> None:
    """No-op callback, of a subscription that no executor serves."""
