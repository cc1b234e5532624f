"""Commands: what a robot is told to do for an action."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeVar

import numpy as np

from rkhs_ros.base.settings import Settings, setting
from rkhs_ros.base.validation import numbers, require
from rkhs_ros.rkhs.kernels import Array

UNITS = {"position": "rad", "velocity": "rad/s", "effort": "N m"}  # of joints that turn, by what is commanded or sensed
KINDS = tuple(UNITS)
T = TypeVar("T")


@dataclass(frozen=True)
class Commands(Settings):
    """How an action becomes a command: within its bounds, times a scale, plus an offset.

    Attributes:
        minimum: shape (n,), of each action.
        maximum: alike.
        scale: in the units of a command for one unit of the action, one or one per action.
        offset: in the units of a command, one or one per action.
        kind: what a command is; motions to the home position depend on it.
        unit: of the commands, one or one per action; empty for that of the kind, of joints that turn.
    """

    minimum: tuple[float, ...] = setting((-1.0,), "least actions", minimum=-1e9, maximum=1e9)
    maximum: tuple[float, ...] = setting((1.0,), "greatest actions", minimum=-1e9, maximum=1e9)
    scale: tuple[float, ...] = setting(
        (1.0,), "command for one unit of the action, one or one per action", minimum=-1e9, maximum=1e9
    )
    offset: tuple[float, ...] = setting(
        (0.0,), "command for the action 0, one or one per action", minimum=-1e9, maximum=1e9
    )
    kind: str = setting("position", "what a command sets", choices=KINDS)
    unit: tuple[str, ...] = setting((), "units for pictures, one or one per action; none for rad, rad/s or N m")

    def __post_init__(self) -> None:
        """Raise ValueError where the sizes do not fit, bounds cross, or an action has no effect."""
        super().__post_init__()
        count = len(self.minimum)
        require(len(self.maximum) == count, "action.maximum", numbers(count), len(self.maximum))
        for name in ("scale", "offset", "unit"):
            size = len(getattr(self, name))
            require(size in (1, count) or (name == "unit" and not size), f"action.{name}", numbers(1, count), size)
        crossed = any(low >= high for low, high in zip(self.minimum, self.maximum, strict=True))
        require(not crossed, "action.minimum", "less than action.maximum", self.minimum)
        require(0.0 not in self.scale, "action.scale", "no 0, which makes actions without effect", self.scale)

    @property
    def dimension(self) -> int:
        """Number of numbers in an action, and in a command."""
        return len(self.minimum)

    def names(self, joints: Sequence[str]) -> tuple[str, ...]:
        """Return what the numbers of an action are called where they command joints: as "elbow position (rad)".

        Of scaled ones the unit is what 1 stands for.
        """
        count = self.dimension
        units, scales = _each(self.unit or (UNITS[self.kind],), count), _each(self.scale, count)
        units = [unit if scale == 1.0 else f"{scale:g} {unit}" for unit, scale in zip(units, scales, strict=True)]
        return tuple(f"{joint} {self.kind} ({unit})" for joint, unit in zip(joints, units, strict=True))

    def command(self, action: Array) -> Array:
        """Return the command for an action, shape (n,) each."""
        bounded = np.clip(action, self.minimum, self.maximum)
        return np.asarray(np.array(self.offset) + np.array(self.scale) * bounded)

    def action(self, command: Array) -> Array:
        """Return the action that has this command, shape (n,) each."""
        return np.asarray((command - np.array(self.offset)) / np.array(self.scale))


def _each(values: Sequence[T], count: int) -> list[T]:
    """Return so many values, where one may stand for all."""
    return list(values) * count if len(values) == 1 else list(values)
