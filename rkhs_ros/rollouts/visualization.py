"""What a task may show of itself beside observations and rewards, for viewers and films."""

from __future__ import annotations

from collections.abc import Sequence
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


class Body(Protocol):
    """A rigid body that is seen.

    Attributes:
        shape: "box", "ball" or "cylinder", whose axis is z.
        size: along x, y and z, in metres.
        colour: as "#0072B2", red, green and blue.
    """

    @property
    def shape(self) -> str: ...  # noqa: D102
    @property
    def size(self) -> tuple[float, float, float]: ...  # noqa: D102
    @property
    def colour(self) -> str: ...  # noqa: D102


class BodyTrajectories(Protocol):
    """How bodies move; z is up.

    Attributes:
        times: of each moment, in seconds, shape (k,).
        places: of the middles, in metres, shape (k, bodies, 3).
        turns: unit quaternions w, x, y, z, shape (k, bodies, 4).
    """

    @property
    def times(self) -> Array: ...  # noqa: D102
    @property
    def places(self) -> Array: ...  # noqa: D102
    @property
    def turns(self) -> Array: ...  # noqa: D102


@runtime_checkable
class ShowsBodies(Protocol):
    """A task whose episodes can be seen in space."""

    def eye(self) -> tuple[float, float, float]:
        """Return the direction, of any length, in which a viewer stands who looks at it."""

    def room(self) -> tuple[tuple[float, float, float], tuple[float, float, float]]:
        """Return the lower and the upper corner of the box in which all of it stays, in metres."""

    def bodies(self) -> Sequence[Body]:
        """Return what is seen."""

    def motion(self, observations: Array, actions: Array) -> BodyTrajectories | None:
        """Return how it moves in an episode; None where nothing moved.

        Args:
            observations: before each action, shape (steps, d).
            actions: within their bounds, shape (steps, n).
        """
