"""Optional interfaces of tasks for viewers and films, besides observations and rewards."""

from collections.abc import Sequence
from typing import Any, NamedTuple, Protocol, runtime_checkable

from rkhs_ros.rkhs.kernels import Array

Corner = tuple[float, float, float]


class Body(NamedTuple):
    """A visible rigid body; a task may return any object with these attributes.

    Attributes:
        shape: "box", "ball" or "cylinder", whose axis is z.
        size: size along x, y and z, in metres.
        colour: RGB colour such as "#0072B2".
    """

    shape: str
    size: tuple[float, float, float]
    colour: str


class BodyTrajectories(NamedTuple):
    """Trajectories of bodies; z points up. A task may return any object with these attributes.

    Attributes:
        times: times in seconds, shape (k,).
        positions: of the centres, in metres, shape (k, bodies, 3).
        orientations: unit quaternions w, x, y, z, shape (k, bodies, 4).
    """

    times: Array
    positions: Array
    orientations: Array


@runtime_checkable
class ShowsBodies(Protocol):
    """Task whose episodes can be shown in 3D.

    Attributes:
        view_direction: from the scene to the camera, of any length.
        bounds: lower and upper corner of the bounding box of the scene, in metres.
    """

    @property
    def view_direction(self) -> Corner: ...  # noqa: D102
    @property
    def bounds(self) -> tuple[Corner, Corner]: ...  # noqa: D102

    def bodies(self) -> Sequence[Any]:
        """Return the visible bodies, with the attributes of `Body`."""

    def motion(self, observations: Array, actions: Array) -> BodyTrajectories | None:
        """Return the trajectories of the bodies in an episode; None if nothing moved.

        Args:
            observations: observation before each action, shape (steps, d).
            actions: actions within their bounds, shape (steps, n).
        """
