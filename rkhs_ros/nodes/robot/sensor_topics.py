"""The topics of a robot's sensors: the newest message of each is stored, and deserialised on demand."""

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

# Only the newest message matters. A best-effort subscription is compatible with reliable publishers as well.
SENSOR_QOS = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)
CHECK_PERIOD_S = 1.0  # between checks for unusable sources, and before the first check


class Use(NamedTuple):
    """The purpose of a topic.

    Attributes:
        name: of the purpose, from the settings.
        topic: its name.
        read: reads a message; raises SensingError if it is unusable.
        is_needed: whether the topic must be usable before the robot may move.
    """

    name: str
    topic: str
    read: Callable[[Any], object]
    is_needed: bool = True


class SensorTopics:
    """Subscriptions to the sensors of a robot.

    Messages are stored serialised, because many more may arrive than are read.

    Owns the newest message of each topic and its arrival time. Reports unusable sensors to the gate.

    Args:
        node: the robot node.
        task: defines the topics.

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
        self._published = ""
        self._due = time.monotonic() + CHECK_PERIOD_S

    def heard(self) -> dict[str, ReceivedMessage]:
        """Return the newest message of each topic that has one."""
        return {topic: self._read(topic) for topic in self._newest}

    def report(self) -> dict[str, str]:
        """Return the state of each source by its diagnostics key."""
        return {PREFIX + use.name: self._sources[use.topic].line(self._flaw(use)) for use in self._uses}

    def obstacle(self) -> str:
        """Return which needed sources are unusable, and why; empty if all are usable."""
        flaws = [(use, self._flaw(use)) for use in self._uses if use.is_needed]
        bad = [(use, flaw) for use, flaw in flaws if flaw or self._sources[use.topic].is_silent]
        return "; ".join(f"{use.name}: {self._sources[use.topic].line(flaw)}" for use, flaw in bad)

    def heartbeat(self, now: float) -> None:
        """Report the unusable sensors to the gate, if they have changed."""
        if now < self._due:
            return
        self._due = now + CHECK_PERIOD_S
        if (obstacle := self.obstacle()) != self._published:
            self._obstacles.publish(String(data=obstacle))
            self._published = obstacle

    def _read(self, topic: str) -> ReceivedMessage:
        content, at = self._newest[topic]
        return ReceivedMessage(deserialize_message(content, self._types[topic]), at)

    def _flaw(self, use: Use) -> str:
        """Return the error of the newest message; empty if it is usable, or if there is none."""
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
    """Yield the uses of a task's topics."""
    reward, home = task.reward, task.reset.home
    yield from (Use(f"sensor {name}", sensor.topic, sensor.numbers) for name, sensor in task.sensors)
    if STEPS[0] in task.reset.steps:
        yield Use("reset.home", home.topic, home.joints_in)
    if reward.topic:
        yield Use("reward", reward.topic, lambda message: field_values(message, reward.field), is_needed=False)
