"""The topics of a robot's sensors: of each the newest message is kept, and read when it is needed."""

from __future__ import annotations

import time
from functools import partial

from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.serialization import deserialize_message

from rkhs_ros.nodes.robot_topics import check_fields
from rkhs_ros.robot.sensors import Heard
from rkhs_ros.robot.task import RobotTask

# Of what comes faster than it is read the newest counts. Best effort hears reliable publishers as well.
SENSOR_QOS = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)


class SensorTopics:
    """Hears the sensors of a robot.

    Messages are kept as they come over the wire, since many more may come than are read.

    Owns the newest message of each topic, and when it came.

    Args:
        node: the robot node.
        task: says which topics.

    Raises:
        ValueError: a type is unknown, or has no such field.
    """

    def __init__(self, node: Node, task: RobotTask) -> None:
        self._types = check_fields(task)
        self._newest: dict[str, tuple[bytes, float]] = {}
        for topic, kind in self._types.items():
            node.create_subscription(kind, topic, partial(self._hear, topic), SENSOR_QOS, raw=True)

    def heard(self) -> dict[str, Heard]:
        """Return the newest message of each topic that was heard."""
        return {
            topic: Heard(deserialize_message(content, self._types[topic]), at)
            for topic, (content, at) in self._newest.items()
        }

    def _hear(self, topic: str, content: bytes) -> None:
        self._newest[topic] = (content, time.monotonic())
