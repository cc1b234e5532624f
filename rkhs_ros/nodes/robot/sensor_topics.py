"""The topics of a robot: their validation, and its sensors, whose newest message is read on demand."""

import importlib
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import partial
from typing import Any, NamedTuple

from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.serialization import deserialize_message
from std_msgs.msg import String

from rkhs_ros.base.validation import require, truncated
from rkhs_ros.nodes.core.diagnostics import OBSTACLE, PREFIX, Source
from rkhs_ros.nodes.core.messages import LATCHED_QOS
from rkhs_ros.robot.sensors import JOINT_STATE, ReceivedMessage, SensingError, check_field, field_values
from rkhs_ros.robot.task import RobotTask

# Only the newest message matters. A best-effort subscription is compatible with reliable publishers as well.
SENSOR_QOS = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)
CHECK_PERIOD_S = 1.0  # between checks for unusable sources, and before the first check


class Use(NamedTuple):
    """A topic, the fields that are read from its messages, and how; it may be needed before the robot may move."""

    name: str
    topic: str
    type: str
    fields: Sequence[str]
    read: Callable[[Any], object]
    is_needed: bool = True


class SensorTopics:
    """Subscriptions to the sensors of a robot.

    Owns the newest message of each topic, serialised, because many more may arrive than are read, and its arrival time.
    Reports unusable sensors to the gate.
    """

    def __init__(self, node: Node, task: RobotTask) -> None:
        self._uses = list(_uses(task))
        self._types = types_of((use.topic, use.type, use.fields) for use in self._uses)
        self._newest: dict[str, tuple[bytes, float]] = {}
        self._sources = {use.topic: Source(node, use.topic, use.type, task.stale_after) for use in self._uses}
        for topic, kind in self._types.items():
            node.create_subscription(kind, topic, partial(self._hear, topic), SENSOR_QOS, raw=True)
        self._obstacles = node.create_publisher(String, OBSTACLE, LATCHED_QOS)
        self._published: str | None = None  # a gate may know the obstacle of an earlier node
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
        try:
            return ReceivedMessage(deserialize_message(content, self._types[topic]), at)
        except RuntimeError as error:  # for example of another version of the type
            raise SensingError(f"{topic}: cannot decode the message: {truncated(error)}") from error

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
    reward, home = task.reward, task.reset.home
    for name, each in task.sensors:
        yield Use(f"sensor {name}", each.topic, each.type, each.fields, each.numbers)
    if "home" in task.reset.steps:
        yield Use("reset.home", home.topic, JOINT_STATE, (), home.joints_in)
    if reward.topic:
        read = partial(field_values, field=reward.field)
        yield Use("reward", reward.topic, reward.type, (reward.field,), read, is_needed=False)


def types_of(topics: Iterable[tuple[str, str, Sequence[str]]]) -> dict[str, Any]:
    """Return the message classes of topics by name; raise ValueError for a bad type or field, or a second type."""
    types: dict[str, Any] = {}
    for topic, name, fields in topics:
        kind = _message_type(name)
        known = types.setdefault(topic, kind)
        require(known is kind, f"topic {topic}", f"one type, {known.__name__}", name)
        for field in fields:
            check_field(kind(), field)
    return types


def check_topics(task: RobotTask) -> None:
    """Raise ValueError if the type of a topic is unknown or has no such field, or a topic has two types."""
    types_of((use.topic, use.type, use.fields) for use in _uses(task))


def _message_type(name: str) -> Any:
    package, _, kind = name.partition("/msg/")
    try:
        return getattr(importlib.import_module(f"{package}.msg"), kind)
    except (ImportError, AttributeError) as error:
        raise ValueError(f"unknown message type '{name}': {truncated(error)}") from error
