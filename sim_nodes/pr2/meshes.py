"""Meshes of the PR2 from the package example-robot-data, which replace its boxes if the package is installed."""

from __future__ import annotations

from functools import cache
from importlib.metadata import PackageNotFoundError, files
from pathlib import Path
from xml.etree import ElementTree
from xml.etree.ElementTree import Element

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

Array = NDArray[np.float64]

PACKAGE, DESCRIPTION = "example-robot-data", "robots/pr2_description/urdf/pr2.urdf"
# Positions of joints that the simulated robot lacks, rad: the left arm is tucked in, the head faces the hand.
REST = {
    "l_shoulder_pan_joint": 0.06,
    "l_shoulder_lift_joint": 1.25,
    "l_upper_arm_roll_joint": 1.79,
    "l_elbow_flex_joint": -1.68,
    "l_forearm_roll_joint": -1.73,
    "l_wrist_flex_joint": -0.10,
    "head_pan_joint": -0.3,
    "head_tilt_joint": 0.5,
}
# Words in the names of meshes, and their colours.
PAINT = {
    "finger": "0.15 0.15 0.17 1",
    "wheel": "0.15 0.15 0.17 1",
    "tilt": "0.3 0.31 0.33 1",
    "forearm": "0.62 0.63 0.66 1",
}
WHITE = "0.92 0.92 0.9 1"  # of all other meshes


TRIANGLE = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
HEADER = 84  # bytes of a binary STL before its triangles


def with_meshes(urdf: str, folder: Path) -> str:
    """Return a URDF whose links have the meshes of the package; return it unchanged if the package is missing.

    Links that the URDF lacks are fixed to their nearest known parent, at the positions `REST`. Contacts and masses do
    not change.

    Args:
        urdf: a robot of boxes.
        folder: for the mesh files.
    """
    path = _description()
    if path is None:
        return urdf
    robot, package = ElementTree.fromstring(urdf), ElementTree.parse(path).getroot()
    ours = {link.get("name", ""): link for link in robot.findall("link")}
    parents = {joint.find("child").get("link"): joint for joint in package.findall("joint")}  # type: ignore[union-attr]
    looks = {link.get("name", ""): link.findall("visual") for link in package.findall("link")}
    for name in ours.keys() & looks.keys():
        for box in ours[name].findall("visual"):
            ours[name].remove(box)
    for name, visuals in looks.items():
        owner, place = _on(name, ours, parents)
        for visual in visuals:
            if owner is not None and visual.find("geometry/mesh") is not None:
                ours[owner].append(_placed(visual, place, path.parents[3], folder))
    return ElementTree.tostring(robot, encoding="unicode")


@cache
def _description() -> Path | None:
    """Return the package's URDF file; None if the package is not installed."""
    try:
        found = [file for file in files(PACKAGE) or () if str(file).endswith(DESCRIPTION)]
    except PackageNotFoundError:
        return None
    paths = [Path(str(file.locate())) for file in found]
    return next((path for path in paths if path.is_file()), None)


def _on(name: str, ours: dict[str, Element], parents: dict[str | None, Element]) -> tuple[str | None, Array]:
    """Return the link of `ours` to which a link is attached (or None), and the link's frame in it, shape (4, 4)."""
    place = np.eye(4)
    while name not in ours:
        if name not in parents:
            return None, place
        joint = parents[name]
        turned = np.eye(4)
        if (axis := joint.find("axis")) is not None:
            angle = REST.get(joint.get("name", ""), 0.0)
            turned[:3, :3] = Rotation.from_rotvec(angle * _numbers(axis.get("xyz", "1 0 0"))).as_matrix()
        place = _frame(joint.find("origin")) @ turned @ place
        name = joint.find("parent").get("link", "")  # type: ignore[union-attr]
    return name, place


def _placed(visual: Element, place: Array, root: Path, folder: Path) -> Element:
    """Return a visual with its mesh file and colour, placed in the frame of the robot's link to which it is attached.

    Args:
        visual: visual of a link of the package.
        place: frame of that link in the robot's link, shape (4, 4).
        root: folder of the package.
        folder: for the mesh file.
    """
    mesh: Element = visual.find("geometry/mesh")  # type: ignore[assignment]
    frame = place @ _frame(visual.find("origin"))
    turn = Rotation.from_matrix(frame[:3, :3]).as_euler("xyz")
    name = mesh.get("filename", "").removeprefix(f"package://{PACKAGE}/")
    colour = next((colour for word, colour in PAINT.items() if word in Path(name).stem), WHITE)
    made = Element("visual")
    ElementTree.SubElement(made, "origin", xyz=_text(frame[:3, 3]), rpy=_text(turn))
    geometry = ElementTree.SubElement(made, "geometry")
    file = folder / Path(name).name
    file.write_bytes(_lit((root / name).read_bytes()))
    ElementTree.SubElement(geometry, "mesh", filename=str(file), scale=mesh.get("scale", "1 1 1"))
    material = ElementTree.SubElement(made, "material", name=f"painted {colour}")
    ElementTree.SubElement(material, "color", rgba=colour)
    return made


def _lit(stl: bytes) -> bytes:
    """Return a mesh with computed normals; some files have zero normals, which render black."""
    triangles = np.frombuffer(stl, TRIANGLE, offset=HEADER).copy()
    a, b, c = np.moveaxis(triangles["corners"], 1, 0)
    normal = np.cross(b - a, c - a)
    triangles["normal"] = normal / np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-12)
    return stl[:HEADER] + triangles.tobytes()


def _frame(origin: Element | None) -> Array:
    frame = np.eye(4)
    if origin is not None:
        frame[:3, :3] = Rotation.from_euler("xyz", _numbers(origin.get("rpy", "0 0 0"))).as_matrix()
        frame[:3, 3] = _numbers(origin.get("xyz", "0 0 0"))
    return frame


def _numbers(text: str) -> Array:
    return np.array([float(word) for word in text.split()])


def _text(values: Array) -> str:
    return " ".join(f"{value:.9g}" for value in values)
