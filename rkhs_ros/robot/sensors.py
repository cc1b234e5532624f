"""Sensors: observations from the messages of a robot's topics."""

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import reduce
from math import isfinite
from typing import Any, NamedTuple

import numpy as np

from rkhs_ros.base.settings import Settings, setting
from rkhs_ros.base.validation import hint, numbers, require, truncated
from rkhs_ros.rkhs.kernels import Array

JOINT_STATE = "sensor_msgs/msg/JointState"
UNITS = {"position": "rad", "velocity": "rad/s", "effort": "N m"}  # of revolute joints, by field of a JointState
JOINT_FIELDS = tuple(UNITS)
# Units of the vectors in standard messages; the orientation of a Pose has none.
UNITS_OF_VECTORS = {
    "position": "m",
    "point": "m",
    "linear": "m/s",
    "angular": "rad/s",
    "linear_acceleration": "m/s²",
    "angular_velocity": "rad/s",
    "force": "N",
    "torque": "N m",
}
PART = re.compile(r"([A-Za-z]\w*)(?:\[(\d+)(?::(\d+))?\])?")  # part of a field: name, name[2] or name[0:3]
TYPE = re.compile(r"[a-z]\w*/msg/[A-Z]\w*")
MOST_NUMBERS = 1000  # per field
Path = tuple[str | int, ...]  # to a number in a message: names of attributes and numbers of entries


class SensingError(Exception):
    """A sensor is silent or stale, or its value is not a number; the message is one line."""


class ReceivedMessage(NamedTuple):
    """The newest message of a topic, and its monotonic time of arrival, seconds."""

    message: Any
    at: float


@dataclass(frozen=True)
class Sensor(Settings):
    """One sensor: a topic, and the observed fields of its messages."""

    topic: str = setting("joint_states", "topic of its messages")
    type: str = setting(JOINT_STATE, "type of its messages")
    fields: tuple[str, ...] = setting(
        ("position", "velocity"), "observed fields, such as linear.x, data[2] or data[0:3]"
    )
    joints: tuple[str, ...] = setting((), "for a JointState: the joints whose fields are observed, in this order")
    units: tuple[str, ...] = setting(
        (), "units for figures, one per field; empty for those implied by the fields' names"
    )

    def __post_init__(self) -> None:
        """Raise ValueError if a name is invalid, or joints are given for another type than JointState."""
        super().__post_init__()
        require(bool(self.topic), "topic", "the name of a topic", repr(self.topic))
        expected = "PACKAGE/msg/TYPE, such as std_msgs/msg/Float64"
        require(bool(TYPE.fullmatch(self.type)), "type", expected, repr(self.type))
        require(bool(self.fields), "fields", "at least one", "none")
        require(len(self.units) in (0, len(self.fields)), "units", numbers(len(self.fields)), len(self.units))
        if self.joints:
            require(self.type == JOINT_STATE, "joints", f"the type {JOINT_STATE}, the only one with joints", self.type)
            unknown = [field for field in self.fields if field not in JOINT_FIELDS]
            require(not unknown, "fields", f"some of {', '.join(JOINT_FIELDS)}", ", ".join(unknown))
        else:
            for field in self.fields:
                paths_of(field)

    @property
    def dimension(self) -> int:
        """Number of observed values."""
        if self.joints:
            return len(self.fields) * len(self.joints)
        return sum(len(paths_of(field)) for field in self.fields)

    def names(self, name: str) -> list[str]:
        """Return the names of the values of the sensor ``name``: "elbow position (rad)" or "tip position.x (m)"."""
        if self.joints:
            units = self.units or [UNITS[field] for field in self.fields]
            pairs = zip(self.fields, units, strict=True)
            return [f"{joint} {field} ({unit})" for field, unit in pairs for joint in self.joints]
        known = UNITS_OF_VECTORS  # by the names that standard messages use
        units = self.units or [
            next((known[key] for key in map(str, paths_of(field)[0]) if key in known), "") for field in self.fields
        ]
        paths = [(path, unit) for field, unit in zip(self.fields, units, strict=True) for path in paths_of(field)]
        return [f"{name} {_end_of(path)}" + f" ({unit})" * bool(unit) for path, unit in paths]

    def numbers(self, message: Any) -> list[float]:
        """Return the observed values of a message, by field and joint; raise SensingError if one is bad."""
        if self.joints:
            values = [each for field in self.fields for each in joint_values(message, field, self.joints)]
        else:
            values = [each for field in self.fields for each in field_values(message, field)]
        if not all(map(isfinite, values)):
            raise SensingError(f"{self.topic}: expected finite numbers, got {truncated(values)}")
        return values


def paths_of(field: str) -> list[Path]:
    """Return the path to each number of a field, ("position", "x") for position.x; raise ValueError if invalid."""
    paths: list[Path] = [()]
    for part in field.split("."):
        match = PART.fullmatch(part)
        if match is None or len(paths) > 1:
            raise ValueError(f"field: expected a path such as linear.x, data[2] or data[0:3], got {field!r}")
        name, first, end = match.groups()
        entries = range(int(first or 0), int(end or first or 0) + (end is None))
        require(0 < len(entries) <= MOST_NUMBERS, "field", f"1 to {MOST_NUMBERS} numbers", repr(field))
        paths = [(*paths[0], name) if first is None else (*paths[0], name, entry) for entry in entries]
    return paths


def _end_of(path: Path) -> str:
    """Return the last two parts of a path as text."""
    text = "".join(f"[{key}]" if isinstance(key, int) else f".{key}" for key in path)
    return ".".join(text[1:].split(".")[-2:])


def check_field(message: Any, field: str) -> None:
    """Raise ValueError if an empty message has no such field; the entries of a sequence cannot be checked."""
    for name in paths_of(field)[0]:
        if isinstance(name, int):
            return
        known = [slot.lstrip("_") for slot in getattr(message, "__slots__", ()) if slot != "_check_fields"]
        if not hasattr(message, name):
            raise ValueError(f"unknown field '{field}' of {type(message).__name__}, {hint(name, dict.fromkeys(known))}")
        message = getattr(message, name)


def field_values(message: Any, field: str) -> list[float]:
    """Return the values in a field; raise SensingError if it is missing or not a number."""
    paths = paths_of(field)
    try:
        return [float(reduce(_entry, path, message)) for path in paths]
    except (AttributeError, IndexError, TypeError, ValueError) as error:
        raise SensingError(f"{field}: expected a number, got {type(error).__name__}: {truncated(error)}") from error


def _entry(value: Any, key: str | int) -> Any:
    return value[key] if isinstance(key, int) else getattr(value, key)


def joint_values(message: Any, field: str, joints: tuple[str, ...]) -> list[float]:
    """Return a field of a JointState for the named joints; raise SensingError if one has no such value."""
    names, values = list(message.name), getattr(message, field)
    if missing := missing_joints(joints, names):
        raise SensingError(missing)
    for joint in joints:
        if names.index(joint) >= len(values):
            raise SensingError(f"{field}: expected a value for joint '{joint}', got {len(values)} values")
    return [float(values[names.index(joint)]) for joint in joints]


def missing_joints(joints: Iterable[str], names: Sequence[str]) -> str:
    """Return an error message that names the joints missing from a message; empty if none is missing."""
    missing = ", ".join(f"'{joint}'" for joint in joints if joint not in names)
    return f"missing joints {missing}, got {truncated(', '.join(names) or 'none')}" if missing else ""


@dataclass(frozen=True)
class Sensors:
    """The sensors of a robot by name; an observation concatenates their values in the order of their names.

    A message is stale after ``stale_after`` seconds.
    """

    by_name: Mapping[str, Sensor]
    stale_after: float

    def __iter__(self) -> Iterator[tuple[str, Sensor]]:
        """Iterate over the sensors in order."""
        return iter(sorted(self.by_name.items()))

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the observation's dimensions, with their units."""
        return tuple(each for name, sensor in self for each in sensor.names(name))

    @property
    def dimension(self) -> int:
        """Dimension of an observation."""
        return sum(sensor.dimension for _, sensor in self)

    def columns(self) -> Iterator[tuple[int, str, Sensor]]:
        """Yield, for each sensor in order, its first column in the observation, its name and itself."""
        begin = 0
        for name, sensor in self:
            yield begin, name, sensor
            begin += sensor.dimension

    def observation(self, heard: Mapping[str, ReceivedMessage], now: float) -> Array:
        """Return the observation, shape (d,), from the newest message of each topic, at a monotonic time in seconds.

        Raises SensingError, which names the sensor that is silent or stale, or whose value is not a number.
        """
        numbers: list[float] = []
        for name, sensor in self:
            try:
                numbers += sensor.numbers(fresh(heard, sensor.topic, now, self.stale_after))
            except SensingError as error:
                raise SensingError(f"sensor {name}: {error}") from error
        return np.array(numbers)


def fresh(heard: Mapping[str, ReceivedMessage], topic: str, now: float, stale_after: float) -> Any:
    """Return the newest message of a topic; raise SensingError if there is none, or it is stale."""
    if topic not in heard:
        raise SensingError(f"no message has arrived on {topic}")
    message, at = heard[topic]
    if now - at > stale_after:
        raise SensingError(
            f"stale: the last message on {topic} arrived {now - at:.3g} s ago (stale_after {stale_after:g})"
        )
    return message
