"""The rules of a robot's task: the reward of a step, and the end of an episode."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, TypeVar

from rkhs_ros.base.endings import RunError
from rkhs_ros.base.settings import Settings, setting
from rkhs_ros.base.user_code import call_user_function, user_function
from rkhs_ros.base.validation import LARGEST, require, truncated
from rkhs_ros.rkhs.kernels import Array
from rkhs_ros.robot.sensors import TYPE, parts_of

T = TypeVar("T")
Rule = Callable[[Array, Array, Array], Any]
ANSWER_TIMEOUT_S = 2.0  # after which a function counts as hanging; the gate has stopped the robot by then
CALLED_WITH = "of observation, executed action and next observation"


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
        parts_of(self.field)


@dataclass(frozen=True)
class End(Settings):
    """The end of an episode before the horizon."""

    function: str = setting("", f"PACKAGE.MODULE:FUNCTION {CALLED_WITH}, true if the episode ends; empty for none")


@dataclass(frozen=True)
class Rules:
    """The user's functions of a task.

    Attributes:
        reward: None if the reward comes from a topic only.
        end: None if nothing ends an episode before the horizon.
    """

    reward: Rule | None
    end: Rule | None

    @classmethod
    def of(cls, reward: Reward, end: End) -> Rules:
        """Return the functions named by the settings.

        Raises:
            ValueError: a function cannot be imported.
        """
        return cls(_named(reward.function, "reward.function"), _named(end.function, "end.function"))

    def step_reward(self, before: Array, executed: Array, after: Array, from_topic: float) -> float:
        """Return the reward of a step.

        Args:
            before: observation before the step, shape (d,).
            executed: executed action, shape (n,).
            after: observation after the step, shape (d,).
            from_topic: value of the reward topic; 0 without one.

        Raises:
            RunError: the function fails, or does not return a finite number.
        """
        step = before, executed, after
        reward = from_topic + (_called(self.reward, "reward", float, "a number", *step) if self.reward else 0.0)
        if not abs(reward) <= LARGEST:  # nan is not
            raise RunError(f"reward: expected a finite number within {LARGEST:g}, got {reward}")
        return reward

    def is_terminal(self, before: Array, executed: Array, after: Array) -> bool:
        """Return whether a step ends the episode.

        Raises:
            RunError: the function fails, or does not return true or false.
        """
        step = before, executed, after
        return _called(self.end, "end", bool, "True or False", *step) if self.end else False


def _named(path: str, what: str) -> Rule | None:
    """Return the function of that name; None for an empty name."""
    return user_function(path, what) if path else None


def _called(function: Rule, what: str, kind: Callable[[Any], T], expected: str, *arrays: Array) -> T:
    """Call a function, and convert its result with `kind`.

    Raises:
        RunError: the function or the conversion fails.
    """
    try:
        answer = call_user_function(function, *arrays, seconds=ANSWER_TIMEOUT_S)
    except RunError as error:
        raise RunError(f"{what} function: {error}") from error
    try:
        return kind(answer)
    except Exception as error:  # the result is the user's object: converting it can raise anything
        raise RunError(f"{what} function: expected {expected}, got {truncated(repr(answer))}") from error
