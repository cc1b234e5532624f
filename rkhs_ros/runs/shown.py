"""What a task may show of itself beside observations and rewards, for viewers and films."""

from __future__ import annotations

from typing import Any, Protocol, runtime_checkable

from rkhs_ros.rkhs.kernels import Array


class JointStates(Protocol):
    """A motion of a robot's joints.

    Attributes:
        names: of the joints.
        positions: one after another, in radians or metres, shape (k, joints).
        period: seconds from one to the next.
    """

    @property
    def names(self) -> tuple[str, ...]: ...  # noqa: D102
    @property
    def positions(self) -> Array: ...  # noqa: D102
    @property
    def period(self) -> float: ...  # noqa: D102


@runtime_checkable
class HasRobot(Protocol):
    """A task with a robot, or one that says that it has none."""

    def joint_states(self) -> JointStates | None:
        """Return what the robot of the first row did in the step just made; None for nothing, or no robot."""

    def robot_description(self) -> str | None:
        """Return the robot's URDF; None for a task without a robot."""


@runtime_checkable
class DrawsItself(Protocol):
    """A task that draws a moment of its first row."""

    states: Any

    def draw(self, axes: Any, state: Array, action: Array) -> None:
        """Draw a state with the action taken in it."""
