"""A robot as its URDF has it: the bodies that are seen, and where its joints take them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any, NamedTuple
from xml.etree import ElementTree
from xml.etree.ElementTree import Element

import numpy as np
from numpy.typing import NDArray
from viser.transforms import SO3

from rkhs_ros.base.files import open_regular, read_whole
from rkhs_ros.rkhs.kernels import Array
from rkhs_ros.robot.urdf import PACKAGE, located

GREY = "#B4B6BA"  # of what has no colour
MIMIC = {"multiplier": 1.0, "offset": 0.0}  # of a joint that mimics another, if the URDF does not say
SHADE = 0.87  # of what is white, which would not be seen before a white page


class Surface(NamedTuple):
    """A rigid body of triangles.

    Attributes:
        shape: "mesh".
        size: of the box around it, in metres.
        colour: as "#0072B2".
        vertices: in metres, shape (k, 3).
        faces: numbers of the vertices of each triangle, shape (m, 3).
    """

    shape: str
    size: tuple[float, float, float]
    colour: str
    vertices: Array
    faces: NDArray[np.int64]


class Primitive(NamedTuple):
    """A box, a ball or a cylinder."""

    shape: str
    size: tuple[float, float, float]
    colour: str


class Joint(NamedTuple):
    """A joint.

    Attributes:
        name: its name.
        kind: of the URDF: revolute, continuous, prismatic or fixed.
        parent: link that it is on.
        frame: its own in that of the link, shape (4, 4).
        axis: of its motion, in its frame.
        middle: of its range.
        leader: name of the joint that it mimics; empty if none.
        multiplier: of the leader's position.
        offset: added to that.
    """

    name: str
    kind: str
    parent: str
    frame: Array
    axis: Array
    middle: float
    leader: str = ""
    multiplier: float = 1.0
    offset: float = 0.0


class Visual(NamedTuple):
    """A body, the link that it is a part of, and its frame in that of the link."""

    link: str
    frame: Array
    body: Surface | Primitive


class UrdfBodies:
    """The bodies of a robot.

    Args:
        file: its URDF. Meshes that are not found, or of unknown formats, are left out.

    Raises:
        ValueError: it is none, or nothing of it can be seen.
        OSError: it cannot be read.
    """

    def __init__(self, file: Path) -> None:
        try:
            root = ElementTree.fromstring(read_whole(file))
        except ElementTree.ParseError as error:
            raise ValueError(f"{file}: expected a URDF, got no XML: {error}") from error
        self._joints = {_attribute(joint, "child", "link"): _joint(joint) for joint in root.findall("joint")}
        self._named = {joint.name: joint for joint in self._joints.values() if joint.name}
        for name in self._named:
            self._check_leaders(file, name)
        paints = {paint.get("name", ""): paint for paint in root.iter("material") if paint.find("color") is not None}
        self.visuals = [visual for link in root.findall("link") for visual in _visuals(link, paints, file.parent)]
        if not self.visuals:
            raise ValueError(f"{file}: expected bodies that are seen, got none")

    @property
    def joints(self) -> frozenset[str]:
        """Names of the joints that can move."""
        return frozenset(joint.name for joint in self._joints.values() if joint.kind != "fixed")

    def frames(self, positions: Mapping[str, Array], count: int) -> list[Array]:
        """Return the frame of each body, shape (count, 4, 4), by the positions of joints.

        A joint of which none is given follows the joint that it mimics, or is in the middle of its range.
        """
        frames: dict[str, Array] = {}
        return [self._frame(visual.link, positions, count, frames) @ visual.frame for visual in self.visuals]

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

    def _check_leaders(self, file: Path, name: str) -> None:
        """Raise ValueError if a joint mimics itself, be it by way of others."""
        leaders, leader = {name}, self._named[name].leader
        while leader in self._named:
            if leader in leaders:
                raise ValueError(f"{file}: joint '{name}': expected it to mimic another joint, got a circle")
            leaders.add(leader)
            leader = self._named[leader].leader


def _moved(joint: Joint, position: Array) -> Array:
    """Return what a joint does to the frame of its link, shape (k, 4, 4)."""
    moved = np.tile(np.eye(4), (len(position), 1, 1))
    if joint.kind in ("revolute", "continuous"):
        moved[:, :3, :3] = SO3.exp(position[:, None] * joint.axis).as_matrix()
    elif joint.kind == "prismatic":
        moved[:, :3, 3] = position[:, None] * joint.axis
    return moved


def _joint(element: Element) -> Joint:
    axis = element.find("axis")
    way = np.array([1.0, 0.0, 0.0]) if axis is None else _numbers(axis.get("xyz", "1 0 0"))
    way = way / max(float(np.linalg.norm(way)), 1e-12)
    frame, kind = _frame(element.find("origin")), element.get("type", "fixed")
    middle = sum(float(_attribute(element, "limit", end) or 0.0) for end in ("lower", "upper")) / 2
    parent = _attribute(element, "parent", "link")
    leader = _attribute(element, "mimic", "joint")
    multiplier, offset = (float(_attribute(element, "mimic", end) or usual) for end, usual in MIMIC.items())
    middle = 0.0 if kind == "continuous" else middle
    return Joint(element.get("name", ""), kind, parent, frame, way, middle, leader, multiplier, offset)


def _visuals(link: Element, paints: Mapping[str, Element], folder: Path) -> Iterator[Visual]:
    for element in link.findall("visual"):
        with suppress(Exception):  # a mesh of a format that nobody here reads, or not there: the rest is still seen
            body = _body(element, _colour(element.find("material"), paints), folder)
            yield Visual(link.get("name", ""), _frame(element.find("origin")), body)


def _body(visual: Element, colour: str, folder: Path) -> Surface | Primitive:
    """Return what a visual shows.

    Raises:
        ValueError: no shape that is known.
        Exception: a mesh cannot be read.
    """
    shape: Any = next(iter(visual.find("geometry") or ()), None)
    match None if shape is None else shape.tag:
        case "box":
            return Primitive("box", three(_numbers(shape.get("size"))), colour)
        case "sphere":
            return Primitive("ball", three(np.full(3, 2 * float(shape.get("radius")))), colour)
        case "cylinder":
            width = 2 * float(shape.get("radius"))
            return Primitive("cylinder", (width, width, float(shape.get("length"))), colour)
        case "mesh":
            return _surface(_mesh_file(shape.get("filename"), folder), _numbers(shape.get("scale", "1 1 1")), colour)
    raise ValueError("visual: expected a box, a sphere, a cylinder or a mesh, got none")


def _surface(file: Path, scale: Array, colour: str) -> Surface:
    import trimesh  # here, since it takes 0.3 s and few need it

    with open_regular(file):  # else a pipe would be waited for
        mesh: Any = trimesh.load(file, force="mesh", skip_materials=True)
    vertices = np.asarray(mesh.vertices) * scale
    return Surface("mesh", three(np.ptp(vertices, axis=0)), colour, vertices, np.asarray(mesh.faces))


def _mesh_file(name: str, folder: Path) -> Path:
    """Return where a mesh is: in a package, or beside the URDF."""
    beside = folder / name.removeprefix("file://").removeprefix(PACKAGE)
    return beside if beside.is_file() else located(name)


def _colour(material: Element | None, paints: Mapping[str, Element]) -> str:
    painted = (
        material if material is None or material.find("color") is not None else paints.get(material.get("name", ""))
    )
    colour = None if painted is None else painted.find("color")
    if colour is None:
        return GREY
    red, green, blue = np.round(255 * SHADE * np.clip(_numbers(colour.get("rgba", "1 1 1 1"))[:3], 0, 1)).astype(int)
    return f"#{red:02X}{green:02X}{blue:02X}"


def _frame(origin: Element | None) -> Array:
    frame = np.eye(4)
    if origin is not None:
        frame[:3, :3] = SO3.from_rpy_radians(*_numbers(origin.get("rpy", "0 0 0"))).as_matrix()
        frame[:3, 3] = _numbers(origin.get("xyz", "0 0 0"))
    return frame


def _attribute(element: Element, tag: str, name: str) -> str:
    found = element.find(tag)
    return "" if found is None else found.get(name, "")


def _numbers(text: str) -> Array:
    return np.array([float(word) for word in text.split()])


def three(values: Array) -> tuple[float, float, float]:
    """Return three numbers as a tuple."""
    x, y, z = (float(value) for value in values)
    return x, y, z
