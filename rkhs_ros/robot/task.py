"""A robot's task: its observations, commands, rewards and end, as given by a configuration."""

import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, TypeVar

import numpy as np

from rkhs_ros.base.endings import RunError
from rkhs_ros.base.settings import Entry, Settings, build, build_section, entries, setting
from rkhs_ros.base.user_code import call_user_function, user_function
from rkhs_ros.base.validation import LARGEST, numbers, require, truncated
from rkhs_ros.policies.spaces import Spaces
from rkhs_ros.rkhs.kernels import Array
from rkhs_ros.robot.limits import KINDS
from rkhs_ros.robot.reset import Reset
from rkhs_ros.robot.sensors import TYPE, UNITS, ReceivedMessage, Sensor, Sensors, field_values, fresh, paths_of

NAME = re.compile(r"[A-Za-z]\w*")
Numbers = tuple[float, ...]
T = TypeVar("T")
Rule = Callable[[Array, Array, Array], Any]
ANSWER_TIMEOUT_S = 2.0  # after which a function counts as hanging; the gate stops the robot after its command_timeout
CALLED_WITH = "of observation, executed action and next observation"


@dataclass(frozen=True)
class Commands(Settings):
    """The affine map from an action to a command: clip to the bounds, multiply by the scale, add the offset."""

    minimum: Numbers = setting((-1.0,), "least actions", minimum=-1e9, maximum=1e9)
    maximum: Numbers = setting((1.0,), "greatest actions", minimum=-1e9, maximum=1e9)
    scale: Numbers = setting(
        (1.0,), "command for one unit of the action, one or one per action", minimum=-1e9, maximum=1e9
    )
    offset: Numbers = setting((0.0,), "command for the action 0, one or one per action", minimum=-1e9, maximum=1e9)
    kind: str = setting("position", "quantity that a command sets", choices=KINDS)
    unit: tuple[str, ...] = setting((), "units for figures, one or one per action; empty for rad, rad/s or N m")

    def __post_init__(self) -> None:
        """Raise ValueError if sizes disagree, bounds are contradictory, or an action has no effect."""
        super().__post_init__()
        count = len(self.minimum)
        require(len(self.maximum) == count, "action.maximum", numbers(count), len(self.maximum))
        for name in ("scale", "offset", "unit"):
            size = len(getattr(self, name))
            require(size in (1, count) or (name == "unit" and not size), f"action.{name}", numbers(1, count), size)
        crossed = any(low >= high for low, high in zip(self.minimum, self.maximum, strict=True))
        require(not crossed, "action.minimum", "less than action.maximum", self.minimum)
        require(0.0 not in self.scale, "action.scale", "nonzero numbers (0 makes actions ineffective)", self.scale)

    @property
    def dimension(self) -> int:
        """Dimension of an action, and of a command."""
        return len(self.minimum)

    def names(self, joints: Sequence[str]) -> tuple[str, ...]:
        """Return the name of each action that commands a joint, for example "elbow position (rad)".

        If the scale is not 1, the unit contains it, for example "elbow position (2 rad)".
        """
        count = self.dimension
        units, scales = _each(self.unit or (UNITS[self.kind],), count), _each(self.scale, count)
        units = [unit if scale == 1.0 else f"{scale:g} {unit}" for unit, scale in zip(units, scales, strict=True)]
        return tuple(f"{joint} {self.kind} ({unit})" for joint, unit in zip(joints, units, strict=True))

    def command(self, action: Array) -> Array:
        """Return the command for an action, both of shape (n,)."""
        bounded = np.clip(action, self.minimum, self.maximum)
        return np.asarray(np.array(self.offset) + np.array(self.scale) * bounded)

    def action(self, command: Array) -> Array:
        """Return the action that results in this command, both of shape (n,)."""
        return np.asarray((command - np.array(self.offset)) / np.array(self.scale))


def _each(values: Sequence[T], count: int) -> list[T]:
    """Return `count` values; a single one is repeated."""
    return list(values) * count if len(values) == 1 else list(values)


@dataclass(frozen=True)
class Reward(Settings):
    """The reward of a step: the result of a function, the value on a topic, or the sum of both."""

    function: str = setting("", f"PACKAGE.MODULE:FUNCTION {CALLED_WITH}")
    topic: str = setting("", "topic whose newest value is added to the reward")
    type: str = setting("std_msgs/msg/Float64", "type of the topic's messages")
    field: str = setting("data", "field of the messages that holds the value")

    def __post_init__(self) -> None:
        """Raise ValueError if the type or the field of the topic is invalid."""
        super().__post_init__()
        require(bool(TYPE.fullmatch(self.type)), "reward.type", "PACKAGE/msg/TYPE", repr(self.type))
        paths_of(self.field)

    @cached_property
    def rule(self) -> Rule | None:
        """The function, None if the reward comes from a topic only; raises ValueError if it cannot be imported."""
        return user_function(self.function, "reward.function") if self.function else None

    def heard(self, messages: Mapping[str, ReceivedMessage], now: float, stale_after: float) -> float:
        """Return the newest value, 0 without one; raise SensingError if it is missing, stale or no number."""
        if not self.topic:
            return 0.0
        (value,) = field_values(fresh(messages, self.topic, now, stale_after), self.field)
        return value

    def of(self, from_topic: float, *arrays: Array) -> float:
        """Return a reward: the value of the function for the arrays, plus that of the topic, which is 0 without one.

        Raises RunError if the function fails, or does not return a finite number.
        """
        reward = from_topic + (_called(self.rule, "reward", float, "a number", *arrays) if self.rule else 0.0)
        if not abs(reward) <= LARGEST:  # nan is not
            raise RunError(f"reward: expected a finite number within {LARGEST:g}, got {reward}")
        return reward


@dataclass(frozen=True)
class End(Settings):
    """The end of an episode before the horizon."""

    function: str = setting("", f"PACKAGE.MODULE:FUNCTION {CALLED_WITH}, true if the episode ends; empty for none")

    @cached_property
    def rule(self) -> Rule | None:
        """The function, None if there is none; raises ValueError if it cannot be imported."""
        return user_function(self.function, "end.function") if self.function else None

    def is_reached(self, before: Array, executed: Array, after: Array) -> bool:
        """Return whether a step ends the episode; raise RunError if the function fails, or returns no boolean."""
        return _called(self.rule, "end", _truth, "True or False", before, executed, after) if self.rule else False


def _truth(answer: Any) -> bool:
    """Return a boolean of Python or numpy; raise TypeError for others, such as None without a return."""
    if np.asarray(answer).dtype != bool:
        raise TypeError
    return bool(answer)


def _called(function: Rule, what: str, kind: Callable[[Any], T], expected: str, *arrays: Array) -> T:
    """Call a function, and convert its result with `kind`; raise RunError if either fails."""
    try:
        answer = call_user_function(function, *arrays, seconds=ANSWER_TIMEOUT_S)
    except RunError as error:
        raise RunError(f"{what} function: {error}") from error
    try:
        return kind(answer)
    except Exception as error:  # the result is the user's object: converting it can raise anything
        raise RunError(f"{what} function: expected {expected}, got {truncated(repr(answer))}") from error


@dataclass(frozen=True)
class RobotTask(Settings):
    """A robot's task."""

    task: str = setting("robot", "name of the task in policies and recordings")
    period: float = setting(0.02, "seconds per step", minimum=0.001, maximum=3600.0)
    action_deadline: float = setting(
        0.5, "fraction of the period within which an action must arrive", minimum=0.01, maximum=1.0
    )
    misses_allowed: int = setting(
        2, "missed action deadlines per episode; one more discards the episode", minimum=0, maximum=10**6
    )
    stale_after: float = setting(0.1, "seconds after which a sensor's message is stale", minimum=1e-3, maximum=3600.0)
    learner_timeout: float = setting(
        0.2, "seconds without a heartbeat of the learner that discard the episode", minimum=0.01, maximum=3600
    )
    veto_window: float = setting(
        0.0, "seconds to hold back a completed episode, during which ~/veto discards it", minimum=0, maximum=3600
    )
    action: Commands = Commands()
    reward: Reward = Reward()
    end: End = End()
    reset: Reset = Reset()
    sensors: Sensors = field(default=Sensors({}, 0.1))  # whose values are observed

    @property
    def spaces(self) -> Spaces:
        """The observation and action spaces, with the names of their dimensions."""
        joints = self.reset.home.joints
        named = self.action.names(joints) if len(joints) == self.action.dimension else ()
        bounds = np.array(self.action.minimum), np.array(self.action.maximum)
        return Spaces((self.sensors.dimension,), *bounds, self.sensors.names, named)

    def entries(self) -> Iterator[Entry]:
        """Yield the settings by their dotted names."""
        yield from entries(self)
        for name, sensor in self.sensors:
            yield from entries(sensor, f"sensors.{name}.")


def robot_task_from(tree: Mapping[str, Any]) -> RobotTask:
    """Return the task of a robot section; raise ValueError for an unknown key or an invalid value."""
    require(isinstance(tree, Mapping), "robot", "a section of keys", repr(tree))
    by_name = sensors_from(tree.get("sensors", {}))
    task = build(RobotTask, {key: value for key, value in tree.items() if key != "sensors"})
    require(bool(NAME.fullmatch(task.task)), "task", "a name of letters, digits and _", repr(task.task))
    require(bool(task.reward.function or task.reward.topic), "reward", "a function or a topic", "neither")
    if "home" in task.reset.steps:
        joints = task.reset.home.joints
        require(
            len(joints) == task.action.dimension,
            "reset.home.joints",
            f"{task.action.dimension}, one for each number of a command",
            ", ".join(joints),
        )
    task = replace(task, sensors=Sensors(by_name, task.stale_after))
    _ = task.reward.rule, task.end.rule  # raise if a function cannot be imported
    return task


def sensors_from(sections: Any) -> dict[str, Sensor]:
    """Return the sensors of a configuration by name; raise ValueError for an unknown key or an invalid value."""
    require(isinstance(sections, Mapping) and len(sections) > 0, "sensors", "a section for each sensor", sections)
    for name in map(str, sections):
        require(bool(NAME.fullmatch(name)), "sensors", "names of letters, digits and _", repr(name))
    return {str(name): build_section(Sensor, section, f"sensors.{name}") for name, section in sections.items()}
