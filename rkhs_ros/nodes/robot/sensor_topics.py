"""The topics of a robot: their validation, and its sensors, whose newest message is read on demand."""

import importlib
import time
from collections.abc import Callable, Iterator
from functools import partial
from typing import Any, NamedTuple

from rclpy.exceptions import NameValidationException
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.serialization import deserialize_message
from rclpy.validate_topic_name import validate_topic_name
from std_msgs.msg import String

from rkhs_ros.base.validation import require, truncated
from rkhs_ros.nodes.core.messages import LATCHED_QOS
from rkhs_ros.nodes.core.publishers import OBSTACLE, PREFIX, Source
from rkhs_ros.nodes.core.spin import in_one_line
from rkhs_ros.robot.gate_settings import GateSettings
from rkhs_ros.robot.reset import STEPS
from rkhs_ros.robot.sensors import JOINT_STATE, ReceivedMessage, SensingError, check_field, field_values
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


def check_topics(task: RobotTask, gate: GateSettings) -> None:
    """Check the topics and services that the robot node and the gate will open.

    Raises:
        ValueError: the name of a topic or service is invalid, a type is unknown, or has no such field.
    """
    for setting, name in _names(task, gate):
        try:
            validate_topic_name(name)
        except NameValidationException as error:
            raise ValueError(f"{setting}: {in_one_line(error)}") from error
    check_fields(task)


def _names(task: RobotTask, gate: GateSettings) -> Iterator[tuple[str, str]]:
    """Yield the used names of topics and services with their settings."""
    yield from ((f"robot.sensors.{name}.topic", sensor.topic) for name, sensor in task.sensors)
    names = {
        "robot.reward.topic": task.reward.topic,
        "robot.reset.home.topic": task.reset.home.topic,
        "robot.reset.trigger.service": task.reset.trigger.service,
        "gate.sensor.topic": gate.sensor.topic,
        "gate.command.topic": gate.command.topic,
    }
    yield from ((setting, name) for setting, name in names.items() if name)


def check_fields(task: RobotTask) -> dict[str, Any]:
    """Return the message classes of all topics that a task reads, by topic.

    Raises:
        ValueError: a type is unknown or has no such field, or a topic has two types.
    """
    types = {topic: message_type(name) for topic, name in topics_of(task).items()}
    fields = [(sensor.topic, field) for _, sensor in task.sensors for field in sensor.fields]
    if task.reward.topic:
        fields.append((task.reward.topic, task.reward.field))
    for topic, field in fields:
        check_field(types[topic](), field)
    return types


def topics_of(task: RobotTask) -> dict[str, str]:
    """Return the type names of all topics that a task reads, by topic.

    Raises:
        ValueError: a topic has two types.
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
    """Return the class of a message type such as ``sensor_msgs/msg/Imu``.

    Raises:
        ValueError: the type is unknown.
    """
    package, _, kind = name.partition("/msg/")
    try:
        return getattr(importlib.import_module(f"{package}.msg"), kind)
    except (ImportError, AttributeError) as error:
        raise ValueError(f"unknown message type '{name}': {truncated(error)}") from error
