"""The rules of a robot's task: what a step earns, and what ends an episode."""

from __future__ import annotations

import importlib
import os
import sys
from collections.abc import Callable
from dataclasses import dataclass
from math import isfinite
from typing import Any

from rkhs_ros.base.endings import RunError
from rkhs_ros.base.settings import Settings, setting
from rkhs_ros.base.validation import require, shown
from rkhs_ros.rkhs.kernels import Array
from rkhs_ros.robot.sensors import TYPE, parts_of

Rule = Callable[[Array, Array, Array], Any]
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
        return cls(imported(reward.function, "reward.function"), imported(end.function, "end.function"))

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
        value = _called(self.reward, "reward", before, executed, after) if self.reward else 0.0
        try:
            reward = float(value) + told
        except (TypeError, ValueError) as error:
            raise RunError(f"reward function: expected a number, got {shown(repr(value))}") from error
        if not isfinite(reward):
            raise RunError(f"reward: expected a finite number, got {reward}")
        return reward

    def ended(self, before: Array, executed: Array, after: Array) -> bool:
        """Return whether the episode ends with a step.

        Raises:
            RunError: the function fails.
        """
        return bool(_called(self.end, "end", before, executed, after)) if self.end else False


def imported(path: str, what: str) -> Rule | None:
    """Return the function ``package.module:function``; None of an empty path.

    Its module is found beside what is installed in the folder that the process was started in, too.

    Raises:
        ValueError: there is none; the message says why.
    """
    if not path:
        return None
    module, colon, name = path.partition(":")
    require(bool(module and colon and name), what, "PACKAGE.MODULE:FUNCTION", repr(path))
    if os.getcwd() not in sys.path:
        sys.path.append(os.getcwd())
    try:
        function = getattr(importlib.import_module(module), name)
    except Exception as error:  # it is somebody's code
        raise ValueError(f"{what}: expected '{path}' to import, got {type(error).__name__}: {shown(error)}") from error
    require(callable(function), what, "a function", repr(function))
    return function  # type: ignore[no-any-return]  # it can be called


def _called(function: Rule, what: str, *arrays: Array) -> Any:
    try:
        return function(*(array.copy() for array in arrays))
    except Exception as error:  # it is somebody's code
        raise RunError(f"{what} function: {type(error).__name__}: {shown(error)}") from error
