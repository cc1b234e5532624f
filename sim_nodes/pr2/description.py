"""The PR2 and its door as described by ``pr2.urdf`` and ``door.urdf``: boxes that revolute joints connect.

Units are metres, radians, kilograms and newtons. All frames of a file are parallel when its joints are at zero:
x forwards, y to the left, z up. The PR2 has its base, its right arm and its gripper, with the torso at a fixed height.
The door's hinge is on the robot's left, and a lever releases its latch.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from importlib.resources import files
from typing import NamedTuple
from xml.etree import ElementTree
from xml.etree.ElementTree import Element

import numpy as np
from numpy.typing import NDArray

from sim_nodes.envs.scene import Body

Array = NDArray[np.float64]
Frames = tuple[Array, Array]  # positions (k, 3) and rotations (k, 3, 3)


class Joint(NamedTuple):
    """A joint between two links; origin and axis, of shape (3,), are in the parent's frame."""

    name: str
    kind: str  # revolute, continuous or fixed
    parent: str
    child: str
    origin: Array
    axis: Array
    lower: float  # -inf for no limit
    upper: float
    effort: float  # greatest torque
    velocity: float


class Box(NamedTuple):
    """A visible box of a link, with its centre in the link's frame, shape (3,)."""

    link: str
    centre: Array
    body: Body


@dataclass(frozen=True)
class Description:
    """The content of a URDF file; the root is the link without a parent."""

    root: str
    joints: tuple[Joint, ...]
    boxes: tuple[Box, ...]

    @property
    def moving(self) -> tuple[Joint, ...]:
        """The joints that are not fixed."""
        return tuple(joint for joint in self.joints if joint.kind != "fixed")

    def placed(self, angles: Mapping[str, Array], base: Frames) -> Frames:
        """Return positions (k, boxes, 3) and rotations (k, boxes, 3, 3) of the boxes.

        Args:
            angles: of the joints by name, each of shape (k,); fixed joints have none.
            base: frames of the root.
        """
        frames, waiting = {self.root: base}, {joint.child: joint for joint in self.joints}

        def frame(link: str) -> Frames:
            if link not in frames:
                joint = waiting[link]
                place, turn = frame(joint.parent)
                place = place + turn @ joint.origin
                if joint.kind != "fixed":
                    turn = turn @ rotation_about(joint.axis, angles[joint.name])
                frames[link] = place, turn
            return frames[link]

        placed = [(frame(box.link), box.centre) for box in self.boxes]
        places = np.stack([place + turn @ centre for (place, turn), centre in placed], axis=1)
        return places, np.stack([turn for (_, turn), _ in placed], axis=1)


def rotation_about(axis: Array | tuple[float, float, float], angles: Array) -> Array:
    """Return the rotation matrices, shape (k, 3, 3), for angles of shape (k,) about one unit axis."""
    x, y, z = axis
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    sine, versine = np.sin(angles)[:, None, None], (1.0 - np.cos(angles))[:, None, None]
    return np.asarray(np.eye(3) + sine * cross + versine * (cross @ cross))


def read(name: str) -> Description:
    """Read a URDF file of this package; its boxes are not rotated in their links."""
    text = files(__package__).joinpath(name).read_text()
    tree = ElementTree.fromstring(text)
    joints = tuple(_joint(element) for element in tree.findall("joint"))
    colours = {each.get("name"): _colour(each) for each in tree.findall("material")}
    boxes = tuple(
        Box(link.get("name", ""), _vector(shown.find("origin"), "xyz"), _body(shown, colours))
        for link in tree.findall("link")
        for shown in link.findall("visual")
    )
    (root,) = {joint.parent for joint in joints} - {joint.child for joint in joints}
    return Description(root, joints, boxes)


def _joint(element: Element) -> Joint:
    parent, child = (str(_found(element, name).get("link")) for name in ("parent", "child"))
    limit, axis = element.find("limit"), element.find("axis")
    bounds = {} if limit is None else limit.attrib
    lower, upper = float(bounds.get("lower", -np.inf)), float(bounds.get("upper", np.inf))
    strength = float(bounds.get("effort", 0.0)), float(bounds.get("velocity", 0.0))
    way = np.zeros(3) if axis is None else _vector(axis, "xyz")
    origin = _vector(element.find("origin"), "xyz")
    return Joint(element.get("name", ""), element.get("type", ""), parent, child, origin, way, lower, upper, *strength)


def _body(visual: Element, colours: Mapping[str | None, str]) -> Body:
    x, y, z = _vector(visual.find("geometry/box"), "size")
    return Body("box", (float(x), float(y), float(z)), colours[_found(visual, "material").get("name")])


def _colour(material: Element) -> str:
    red, green, blue, _ = (round(255 * part) for part in _vector(_found(material, "color"), "rgba"))
    return f"#{red:02X}{green:02X}{blue:02X}"


def _found(element: Element, path: str) -> Element:
    found = element.find(path)
    if found is None:
        raise ValueError(f"{element.tag}: expected a {path}, got none")
    return found


def _vector(element: Element | None, name: str) -> Array:
    return np.array([float(word) for word in (element.get(name, "") if element is not None else "0 0 0").split()])


PR2, DOOR = read("pr2.urdf"), read("door.urdf")
