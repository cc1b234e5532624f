"""Rigid bodies on the page, and their poses."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from rkhs_ros.rkhs.kernels import Array

NO_TURN = (1.0, 0.0, 0.0, 0.0)  # unit quaternion w, x, y, z


class Primitive(NamedTuple):
    """A box, a ball or a cylinder; implements `rkhs_ros.rollouts.visualization.Body`."""

    shape: str
    size: tuple[float, float, float]
    colour: str


class Surface(NamedTuple):
    """A rigid body made of triangles.

    Attributes:
        shape: always "mesh".
        size: edge lengths of the bounding box, in metres.
        colour: hexadecimal, such as "#0072B2".
        vertices: positions in metres, shape (k, 3).
        faces: vertex indices of each triangle, shape (m, 3).
    """

    shape: str
    size: tuple[float, float, float]
    colour: str
    vertices: Array
    faces: NDArray[np.int64]


class Poses(NamedTuple):
    """The pose of each body at each step; implements `rkhs_ros.rollouts.visualization.BodyTrajectories`."""

    times: Array
    positions: Array
    orientations: Array


def three(values: Array) -> tuple[float, float, float]:
    """Return three numbers as a tuple."""
    x, y, z = (float(value) for value in values)
    return x, y, z
