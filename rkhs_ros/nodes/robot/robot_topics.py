"""Validation of a robot's topics, services and types before any of its nodes runs."""

import importlib
from collections.abc import Iterator
from typing import Any

from rclpy.exceptions import NameValidationException
from rclpy.validate_topic_name import validate_topic_name

from rkhs_ros.base.validation import require, truncated
from rkhs_ros.nodes.core.names import in_one_line
from rkhs_ros.robot.gate_settings import GateSettings
from rkhs_ros.robot.reset import STEPS
from rkhs_ros.robot.sensors import JOINT_STATE, check_field
from rkhs_ros.robot.task import RobotTask


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
