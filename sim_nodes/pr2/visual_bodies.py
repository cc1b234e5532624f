"""The robot and the door as moving bodies for viewers: the boxes of their links, posed by the joints."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from sim_nodes.envs.vector_task import Body, BodyTrajectories
from sim_nodes.pr2 import door, robot
from sim_nodes.pr2.kinematics import rotation_about
from sim_nodes.pr2.robot import Joint, Link, Vector

Array = NDArray[np.float64]
Frames = tuple[Array, Array]  # positions (k, 3) and rotations (k, 3, 3)

ROBOT = (*robot.FIXED, robot.TORSO, *robot.MOVING)


def bodies() -> list[Body]:
    """Return the boxes of the robot and of the door."""
    return [
        Body("box", _size(low, high), _colour(colours[colour]))
        for links, colours in ((robot.LINKS, robot.COLOURS), (door.LINKS, door.COLOURS))
        for link in links
        for low, high, colour in _boxes(link)
    ]


def motion(
    base: Array, robot_joints: Mapping[str, Array], door_joints: Mapping[str, Array], period: float
) -> BodyTrajectories:
    """Return the bodies' trajectories.

    Args:
        base: pose of the robot, x, y in metres, and its yaw.
        robot_joints: positions of its joints by name, each of shape (k,).
        door_joints: angles of the door's hinge and lever by name, each of shape (k,).
        period: seconds between successive positions.
    """
    count = len(next(iter(robot_joints.values())))
    stand = np.tile([base[0], base[1], 0.0], (count, 1)), rotation_about(robot.Z, np.full(count, base[2]))
    frame = np.zeros((count, 3)), np.tile(np.eye(3), (count, 1, 1))
    placed = [
        *_placed(robot.LINKS, ROBOT, robot_joints, stand),
        *_placed(door.LINKS, door.JOINTS, door_joints, frame),
    ]
    positions, orientations = (np.stack(each, axis=1) for each in zip(*placed, strict=True))
    return BodyTrajectories(period * np.arange(count, dtype=np.float64), positions, orientations)


def _placed(
    links: Sequence[Link], joints: Sequence[Joint], positions: Mapping[str, Array], root: Frames
) -> Iterator[Frames]:
    """Yield the positions and quaternions of each box, in the order of the links."""
    frames = {links[0].name: root}
    waiting = {joint.child: joint for joint in joints}
    for link in links:
        place, rotation = _frame(link.name, waiting, positions, frames)
        for low, high, _ in _boxes(link):
            yield place + rotation @ (np.add(low, high) / 2), _quaternions(rotation)


def _frame(link: str, joints: Mapping[str, Joint], positions: Mapping[str, Array], frames: dict[str, Frames]) -> Frames:
    """Return the frame of a link, computed recursively from its parent's frame and joint."""
    if link not in frames:
        joint = joints[link]
        place, rotation = _frame(joint.parent, joints, positions, frames)
        moved = positions.get(joint.name, np.zeros(len(place)))
        place = place + rotation @ np.array(joint.origin)
        if joint.kind == "prismatic":
            place = place + (rotation @ np.array(joint.axis)) * moved[:, None]
        elif joint.kind != "fixed":
            rotation = rotation @ rotation_about(joint.axis, moved)
        frames[link] = place, rotation
    return frames[link]


def _boxes(link: Link) -> list[tuple[Vector, Vector, str]]:
    own = [] if link.box is None else [(*link.box, link.colour)]
    return [*own, *link.decor]


def _size(low: Vector, high: Vector) -> Vector:
    x, y, z = np.subtract(high, low)
    return float(x), float(y), float(z)


def _colour(text: str) -> str:
    red, green, blue, _ = (round(255 * float(part)) for part in text.split())
    return f"#{red:02X}{green:02X}{blue:02X}"


def _quaternions(rotations: Array) -> Array:
    r"""Return unit quaternions w, x, y, z of rotation matrices, shape (k, 3, 3).

    The entries of :math:`4 q q^\top` are sums of entries of the matrix. The quaternion is its normalised row with the
    largest diagonal entry, which is the most accurate one.
    """
    r = rotations
    xx, yy, zz = r[:, 0, 0], r[:, 1, 1], r[:, 2, 2]
    x, y, z = r[:, 2, 1] - r[:, 1, 2], r[:, 0, 2] - r[:, 2, 0], r[:, 1, 0] - r[:, 0, 1]
    xy, xz, yz = r[:, 0, 1] + r[:, 1, 0], r[:, 0, 2] + r[:, 2, 0], r[:, 1, 2] + r[:, 2, 1]
    products = np.stack(
        [
            1 + xx + yy + zz,
            x,
            y,
            z,
            x,
            1 + xx - yy - zz,
            xy,
            xz,
            y,
            xy,
            1 - xx + yy - zz,
            yz,
            z,
            xz,
            yz,
            1 - xx - yy + zz,
        ],
        axis=1,
    ).reshape(-1, 4, 4)
    best = products[np.arange(len(r)), np.argmax(np.diagonal(products, axis1=1, axis2=2), axis=1)]
    return np.asarray(best / np.linalg.norm(best, axis=1, keepdims=True))
