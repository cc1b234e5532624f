"""The topics of a robot's sensors: of each the newest message is kept, and read when it is needed."""

from __future__ import annotations

import importlib
import time
from collections.abc import Mapping
from functools import partial
from typing import Any

from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.serialization import deserialize_message

from rkhs_ros.base.validation import require, shown
from rkhs_ros.robot.reset import STEPS
from rkhs_ros.robot.sensors import JOINT_STATE, Heard, check_field
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
        self._types = {topic: message_type(name) for topic, name in topics_of(task).items()}
        _check_fields(task, self._types)
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


def topics_of(task: RobotTask) -> dict[str, str]:
    """Return the types of all topics that a task has read, by topic.

    Raises:
        ValueError: a topic is to have two types.
    """
    wanted = [(sensor.topic, sensor.type) for _, sensor in task.sensors]
    if task.reward.topic:
        wanted.append((task.reward.topic, task.reward.type))
    if STEPS[0] in task.reset.steps:
        wanted.append((task.reset.home.topic, JOINT_STATE))
    types = dict(wanted)
    for topic, name in wanted:
        require(types[topic] == name, f"topic {topic}", f"one type, {types[topic]}", name)
    return types


def message_type(name: str) -> Any:
    """Return the class of a type of messages, as ``sensor_msgs/msg/Imu``.

    Raises:
        ValueError: there is none of that name.
    """
    package, _, kind = name.partition("/msg/")
    try:
        return getattr(importlib.import_module(f"{package}.msg"), kind)
    except (ImportError, AttributeError) as error:
        raise ValueError(f"unknown type of messages '{name}': {shown(error)}") from error


def _check_fields(task: RobotTask, types: Mapping[str, Any]) -> None:
    fields = [(sensor.topic, field) for _, sensor in task.sensors for field in sensor.fields]
    if task.reward.topic:
        fields.append((task.reward.topic, task.reward.field))
    for topic, field in fields:
        check_field(types[topic](), field)
