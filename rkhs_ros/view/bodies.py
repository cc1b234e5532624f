"""Rigid bodies on the page and their poses; the bodies of a robot, read from its URDF, and their frames."""

from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any, NamedTuple
from xml.etree.ElementTree import Element

import numpy as np
from numpy.typing import NDArray
from viser.transforms import SE3, SO3

from rkhs_ros.base.validation import require
from rkhs_ros.pictures.known import Body
from rkhs_ros.rkhs.kernels import Array
from rkhs_ros.robot.urdf import PACKAGE, located, read_urdf

NO_TURN = (1.0, 0.0, 0.0, 0.0)  # unit quaternion w, x, y, z
GREY = "#B4B6BA"  # of bodies without a colour
SHADE = 0.87  # darkens all colours, so that white is visible on a white page


class Surface(NamedTuple):
    """A rigid body made of triangles: vertices in metres, shape (k, 3), and their indices, shape (m, 3)."""

    shape: str
    size: tuple[float, float, float]
    colour: str
    vertices: Array
    faces: NDArray[np.int64]


def three(values: Array) -> tuple[float, float, float]:
    """Return three numbers as a tuple."""
    x, y, z = (float(value) for value in values)
    return x, y, z


class Joint(NamedTuple):
    """A joint of a URDF."""

    name: str
    kind: str  # revolute, continuous, prismatic or fixed
    parent: str  # link
    frame: Array  # in that of the parent link, shape (4, 4)
    axis: Array  # unit vector of the motion, in the joint's frame
    middle: float  # of the range of positions
    leader: str  # joint that this one mimics; empty if none
    multiplier: float  # of the leader's position
    offset: float  # added to the multiplied position


class UrdfBodies:
    """The visible bodies of a robot, from its URDF; meshes that are missing or of an unknown format are left out."""

    def __init__(self, file: Path) -> None:
        root = read_urdf(file)
        self._joints = {_value(joint, "child", "link"): _joint(joint) for joint in root.findall("joint")}
        self._named = {joint.name: joint for joint in self._joints.values() if joint.name}
        rgba = {
            paint.get("name", ""): text for paint in root.iter("material") if (text := _value(paint, "color", "rgba"))
        }
        self.bodies: list[Surface | Body] = []
        self._places: list[tuple[str, Array]] = []  # of each body: its link, and its frame in that of the link
        for link in root.findall("link"):
            for visual in link.findall("visual"):
                with suppress(Exception):  # a missing or unreadable mesh must not hide the other bodies
                    place = link.get("name", ""), _frame(visual)
                    self.bodies.append(_body(visual, _colour(visual, rgba), file.parent))
                    self._places.append(place)
        require(bool(self.bodies), f"{file}", "visible bodies", "none")

    def frames(self, positions: Mapping[str, Array], count: int) -> list[Array]:
        """Return the frame of each body at a number of moments, shape (count, 4, 4).

        A joint without a position follows the joint that it mimics, or stays in the middle of its range.
        """
        frames: dict[str, Array] = {}
        return [self._frame(link, positions, count, frames) @ frame for link, frame in self._places]

    def _frame(self, link: str, positions: Mapping[str, Array], count: int, frames: dict[str, Array]) -> Array:
        if link not in frames:
            joint = self._joints.get(link)
            if joint is None:
                frames[link] = np.tile(np.eye(4), (count, 1, 1))
            else:
                moved = _moved(joint, self._position(joint, positions, count))
                frames[link] = self._frame(joint.parent, positions, count, frames) @ joint.frame @ moved
        return frames[link]

    def _position(self, joint: Joint, positions: Mapping[str, Array], count: int) -> Array:
        if joint.name in positions:
            return positions[joint.name]
        if joint.leader in self._named:
            return joint.multiplier * self._position(self._named[joint.leader], positions, count) + joint.offset
        return np.full(count, joint.middle)


def _moved(joint: Joint, position: Array) -> Array:
    """Return the transforms of a joint at some positions, shape (k, 4, 4)."""
    along = position[:, None] * joint.axis
    turn, shift = along * (joint.kind in ("revolute", "continuous")), along * (joint.kind == "prismatic")
    return np.asarray(SE3.from_rotation_and_translation(SO3.exp(turn), shift).as_matrix(), dtype=np.float64)


def _joint(element: Element) -> Joint:
    axis = _numbers(_value(element, "axis", "xyz", "1 0 0"))
    kind = element.get("type", "fixed")
    middle = sum(float(_value(element, "limit", end, "0")) for end in ("lower", "upper")) / 2
    return Joint(
        name=element.get("name", ""),
        kind=kind,
        parent=_value(element, "parent", "link"),
        frame=_frame(element),
        axis=axis / max(float(np.linalg.norm(axis)), 1e-12),
        middle=0.0 if kind == "continuous" else middle,
        leader=_value(element, "mimic", "joint"),
        multiplier=float(_value(element, "mimic", "multiplier", "1")),
        offset=float(_value(element, "mimic", "offset", "0")),
    )


def _body(visual: Element, colour: str, folder: Path) -> Surface | Body:
    shape = visual.findall("geometry/*")[0]
    match shape.tag:
        case "box":
            return Body("box", three(_numbers(shape.attrib["size"])), colour)
        case "sphere":
            return Body("ball", (2 * float(shape.attrib["radius"]),) * 3, colour)
        case "cylinder":
            width = 2 * float(shape.attrib["radius"])
            return Body("cylinder", (width, width, float(shape.attrib["length"])), colour)
    import trimesh  # imported on use: it takes 0.3 s, and most robots have no meshes

    name = shape.attrib["filename"]
    beside = folder / name.removeprefix("file://").removeprefix(PACKAGE)
    mesh: Any = trimesh.load(beside if beside.is_file() else located(name), force="mesh", skip_materials=True)
    vertices = np.asarray(mesh.vertices) * _numbers(shape.get("scale", "1 1 1"))
    return Surface("mesh", three(np.ptp(vertices, axis=0)), colour, vertices, np.asarray(mesh.faces))


def _colour(visual: Element, paints: Mapping[str, str]) -> str:
    rgba = _value(visual, "material/color", "rgba") or paints.get(_value(visual, "material", "name"))
    if rgba is None:
        return GREY
    red, green, blue = np.round(255 * SHADE * np.clip(_numbers(rgba)[:3], 0, 1)).astype(int)
    return f"#{red:02X}{green:02X}{blue:02X}"


def _frame(element: Element) -> Array:
    """Return the frame at the origin element of a joint or a visual, shape (4, 4)."""
    place, angles = (_numbers(_value(element, "origin", name, "0 0 0")) for name in ("xyz", "rpy"))
    frame = SE3.from_rotation_and_translation(SO3.from_rpy_radians(*angles), place)
    return np.asarray(frame.as_matrix(), dtype=np.float64)


def _value(element: Element, path: str, name: str, default: str = "") -> str:
    """Return an attribute of a child element; the default if the child or the attribute is missing or empty."""
    found = element.find(path)
    return (None if found is None else found.get(name)) or default


def _numbers(text: str) -> Array:
    return np.array([float(word) for word in text.split()])
