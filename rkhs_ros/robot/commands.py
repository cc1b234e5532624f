"""Conversion of a policy's actions to a robot's commands."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeVar

import numpy as np

from rkhs_ros.base.settings import Settings, setting
from rkhs_ros.base.validation import numbers, require
from rkhs_ros.rkhs.kernels import Array

UNITS = {"position": "rad", "velocity": "rad/s", "effort": "N m"}  # of revolute joints
KINDS = tuple(UNITS)
T = TypeVar("T")


@dataclass(frozen=True)
class Commands(Settings):
    """The affine map from an action to a command: clip to the bounds, multiply by the scale, add the offset.

    Attributes:
        minimum: least action, shape (n,).
        maximum: greatest action, shape (n,).
        scale: change of the command per unit of the action, one number or one per action.
        offset: command for the action 0, one number or one per action.
        kind: quantity that a command sets; the motion to the home position depends on it.
        unit: of the commands, one or one per action; if empty, that of the kind for revolute joints.
    """

    minimum: tuple[float, ...] = setting((-1.0,), "least actions", minimum=-1e9, maximum=1e9)
    maximum: tuple[float, ...] = setting((1.0,), "greatest actions", minimum=-1e9, maximum=1e9)
    scale: tuple[float, ...] = setting(
        (1.0,), "command for one unit of the action, one or one per action", minimum=-1e9, maximum=1e9
    )
    offset: tuple[float, ...] = setting(
        (0.0,), "command for the action 0, one or one per action", minimum=-1e9, maximum=1e9
    )
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
