"""The rules of a robot's task: what a step earns, and what ends an episode."""

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
ANSWER_TIMEOUT_S = 2.0  # of a function, after which it is taken to hang; the gate has stopped the robot by then
CALLED_WITH = "of observation, executed action and next observation"


@dataclass(frozen=True)
class Reward(Settings):
    """What a step earns: what a function returns, a value on a topic, or the sum of both."""

    function: str = setting("", f"PACKAGE.MODULE:FUNCTION {CALLED_WITH}")
    topic: str = setting("", "topic whose newest value is earned")
    type: str = setting("std_msgs/msg/Float64", "type of the topic's messages")
    field: str = setting("data", "field of the messages that holds the value")

    def __post_init__(self) -> None:
        """Raise ValueError where there is neither, or the topic's value is none."""
        super().__post_init__()
        require(bool(TYPE.fullmatch(self.type)), "reward.type", "PACKAGE/msg/TYPE", repr(self.type))
        parts_of(self.field)


@dataclass(frozen=True)
class End(Settings):
    """What ends an episode before the horizon."""

    function: str = setting("", f"PACKAGE.MODULE:FUNCTION {CALLED_WITH}, true where the episode ends; none where empty")


@dataclass(frozen=True)
class Rules:
    """The functions of a task, which are somebody's code.

    Attributes:
        reward: None where a topic alone tells the reward.
        end: None where nothing ends an episode before the horizon.
    """

    reward: Rule | None
    end: Rule | None

    @classmethod
    def of(cls, reward: Reward, end: End) -> Rules:
        """Return the functions that the settings name.

        Raises:
            ValueError: one cannot be imported.
        """
        return cls(_named(reward.function, "reward.function"), _named(end.function, "end.function"))

    def earned(self, before: Array, executed: Array, after: Array, told: float) -> float:
        """Return the reward of a step.

        Args:
            before: observation before it, shape (d,).
            executed: action that was executed, shape (n,).
            after: observation after it, shape (d,).
            told: by a topic; 0 where there is none.

        Raises:
            RunError: the function fails, or returns what is no finite number.
        """
        step = before, executed, after
        reward = told + (_called(self.reward, "reward", float, "a number", *step) if self.reward else 0.0)
        if not abs(reward) <= LARGEST:  # nan is not
            raise RunError(f"reward: expected a finite number of at most {LARGEST:g} in size, got {reward}")
        return reward

    def ended(self, before: Array, executed: Array, after: Array) -> bool:
        """Return whether the episode ends with a step.

        Raises:
            RunError: the function fails, or returns what is neither true nor false.
        """
        step = before, executed, after
        return _called(self.end, "end", bool, "True or False", *step) if self.end else False


def _named(path: str, what: str) -> Rule | None:
    """Return the function of that name; None of an empty one."""
    return user_function(path, what) if path else None


def _called(function: Rule, what: str, kind: Callable[[Any], T], expected: str, *arrays: Array) -> T:
    """Return what a function answers as a value of that kind.

    Raises:
        RunError: it fails, or its answer is none.
    """
    try:
        answer = call_user_function(function, *arrays, seconds=ANSWER_TIMEOUT_S)
    except RunError as error:
        raise RunError(f"{what} function: {error}") from error
    try:
        return kind(answer)
    except Exception as error:  # the answer is somebody's, too
        raise RunError(f"{what} function: expected {expected}, got {truncated(repr(answer))}") from error
