"""The topic on which other nodes request a stop, with the publisher of each message.

In ROS 2 Jazzy, rclpy does not pass the publisher to a callback. The messages are therefore taken with rcl directly, in
the same way as rclpy does.
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

DEPTH = 256  # messages between two checks, from all publishers together
# A transient-local subscription does not match a volatile publisher, nor a reliable one a best-effort one. For any
# publisher, one of these is the best match. A message that arrives twice counts once.
QOS = (
    QoSProfile(depth=DEPTH, durability=DurabilityPolicy.TRANSIENT_LOCAL),
    QoSProfile(depth=DEPTH),
    QoSProfile(depth=DEPTH, reliability=ReliabilityPolicy.BEST_EFFORT),
)
UNKNOWN = "_NODE_NAME_UNKNOWN_"  # rmw's name of a node whose name is not known yet
OK = 0  # RCL_RET_OK: a message was taken


class _MessageInfo(ctypes.Structure):
    """rmw_message_info_t of rmw/types.h, with space for fields of later versions."""

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
    """A subscription to a std_msgs/Bool topic with the publisher of each message.

    Owns the newest message of each publisher, the names of their nodes, and a separate node for its subscriptions, so
    that no executor takes their messages.

    Args:
        node: the gate node.
        topic: of the stop requests.
        timeout: seconds of silence that mean stop; 0 for no timeout.
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
        """Take the new messages; return the reason for a stop with its publishers, empty if there is none."""
        full = [all(self._hear(subscription) for _ in range(DEPTH)) for subscription in self._subscriptions]
        if any(full):  # a request may have been lost
            return (
                f"{STOP_REQUESTED} on the topic '{self._topic}', perhaps: {DEPTH} or more messages between two checks"
            )
        if not self._stops.requests.keys() <= self._names.keys():
            self._names |= self._present(named=True)
        return self._stops.reason(time.monotonic(), self._names)

    def drop_departed(self) -> None:
        """Remove publishers that no longer exist; only an operator who arms the gate may do so."""
        self._stops = self._stops.without_departed(self._present())

    def _hear(self, subscription: Subscription) -> bool:
        """Take a message; return whether there was one."""
        data, info = ctypes.c_bool(), _MessageInfo()  # a std_msgs/Bool of C is one bool
        with subscription.handle:
            if self._take(subscription.handle.pointer, ctypes.byref(data), ctypes.byref(info), None) != OK:
                return False
        request = StopRequest(data.value, info.publication_sequence_number, time.monotonic())
        self._stops = self._stops.with_request(bytes(info.publisher_gid), request)
        return True

    def _present(self, *, named: bool = False) -> dict[bytes, str]:
        """Return the full name of each publisher's node; with `named`, only known names."""
        infos = self._node.get_publishers_info_by_topic(self._topic)
        return {
            bytes(info.endpoint_gid): full_name(info) for info in infos if not (named and info.node_name == UNKNOWN)
        }


def _no_callback(message: Bool) -> None:
    """No-op callback, of a subscription that no executor serves."""
