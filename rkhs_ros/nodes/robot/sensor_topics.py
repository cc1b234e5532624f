"""The topics of a robot's sensors: of each the newest message is kept, and read when it is needed."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from functools import partial
from typing import Any, NamedTuple

from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.serialization import deserialize_message
from std_msgs.msg import String

from rkhs_ros.nodes.core.messages import LATCHED_QOS
from rkhs_ros.nodes.core.sources import OBSTACLE, PREFIX, Source
from rkhs_ros.nodes.robot.robot_topics import check_fields, topics_of
from rkhs_ros.robot.reset import STEPS
from rkhs_ros.robot.sensors import ReceivedMessage, SensingError, field_values
from rkhs_ros.robot.task import RobotTask

# Of what comes faster than it is read the newest counts. Best effort hears reliable publishers as well.
SENSOR_QOS = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)
CHECK_PERIOD_S = 1.0  # between looks at what cannot be used, and before the first


class Use(NamedTuple):
    """What a topic is heard for.

    Attributes:
        name: of the use, after the setting.
        topic: that is heard.
        read: reads a message; raises SensingError if it cannot be used.
        is_needed: whether it must be heard before the robot may move.
    """

    name: str
    topic: str
    read: Callable[[Any], object]
    is_needed: bool = True


class SensorTopics:
    """Hears the sensors of a robot.

    Messages are kept as they come over the wire, since many more may come than are read.

    Owns the newest message of each topic, and when it came; tells the gate which sensors cannot be used.

    Args:
        node: the robot node.
        task: says which topics.

    Raises:
        ValueError: a type is unknown, or has no such field.
    """

    def __init__(self, node: Node, task: RobotTask) -> None:
        self._types = check_fields(task)
        self._uses = list(_uses(task))
        self._newest: dict[str, tuple[bytes, float]] = {}
        kinds = topics_of(task)
        self._sources = {topic: Source(node, topic, kind, task.stale_after) for topic, kind in kinds.items()}
        for topic, kind in self._types.items():
            node.create_subscription(kind, topic, partial(self._hear, topic), SENSOR_QOS, raw=True)
        self._obstacles = node.create_publisher(String, OBSTACLE, LATCHED_QOS)
        self._told = ""
        self._due = time.monotonic() + CHECK_PERIOD_S

    def heard(self) -> dict[str, ReceivedMessage]:
        """Return the newest message of each topic that was heard."""
        return {topic: self._read(topic) for topic in self._newest}

    def report(self) -> dict[str, str]:
        """Return how each source fares, by the key to report it under."""
        return {PREFIX + use.name: self._sources[use.topic].line(self._flaw(use)) for use in self._uses}

    def obstacle(self) -> str:
        """Return which of the sources that are needed cannot be used, and why; empty if all can."""
        flaws = [(use, self._flaw(use)) for use in self._uses if use.is_needed]
        bad = [(use, flaw) for use, flaw in flaws if flaw or self._sources[use.topic].is_silent]
        return "; ".join(f"{use.name}: {self._sources[use.topic].line(flaw)}" for use, flaw in bad)

    def heartbeat(self, now: float) -> None:
        """Tell the gate what changed of the sensors that cannot be used."""
        if now < self._due:
            return
        self._due = now + CHECK_PERIOD_S
        if (obstacle := self.obstacle()) != self._told:
            self._obstacles.publish(String(data=obstacle))
            self._told = obstacle

    def _read(self, topic: str) -> ReceivedMessage:
        content, at = self._newest[topic]
        return ReceivedMessage(deserialize_message(content, self._types[topic]), at)

    def _flaw(self, use: Use) -> str:
        """Return what is wrong with the newest message; empty if nothing, or if there is none."""
        if use.topic in self._newest:
            try:
                use.read(self._read(use.topic).message)
            except SensingError as error:
                return str(error)
        return ""

    def _hear(self, topic: str, content: bytes) -> None:
        self._newest[topic] = (content, time.monotonic())
        self._sources[topic].hear()


def _uses(task: RobotTask) -> Iterator[Use]:
    """Walk through what the topics of a task are heard for."""
    reward, home = task.reward, task.reset.home
    yield from (Use(f"sensor {name}", sensor.topic, sensor.numbers) for name, sensor in task.sensors)
    if STEPS[0] in task.reset.steps:
        yield Use("reset.home", home.topic, home.joints_in)
    if reward.topic:
        yield Use("reward", reward.topic, lambda message: field_values(message, reward.field), is_needed=False)
