"""The PR2's base, torso, right arm and gripper as data, and as a URDF of primitive shapes.

The data are facts of the public robot description, in metres, radians, kilograms and newtons. All frames are parallel
when all joints are at zero: x forwards, y to the left, z up.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]
Vector = tuple[float, float, float]
Limits = tuple[float, float, float, float, float]  # lower, upper, effort, velocity, damping


class Joint(NamedTuple):
    """A joint.

    Attributes:
        name: on the robot.
        kind: URDF type: revolute, continuous, prismatic or fixed.
        parent: parent link.
        child: child link.
        origin: position in the parent's frame.
        axis: of the motion, in the parent's frame.
        lower: least position, -inf for no limit.
        upper: greatest position, inf for no limit.
        effort: greatest torque (N m) or force (N).
        velocity: greatest speed, in rad/s or m/s.
        damping: torque per speed.
        mimics: joint that it follows mechanically.
    """

    name: str
    kind: str
    parent: str
    child: str
    origin: Vector
    axis: Vector = (0.0, 0.0, 0.0)
    lower: float = 0.0
    upper: float = 0.0
    effort: float = 0.0
    velocity: float = 0.0
    damping: float = 0.0
    mimics: str | None = None


class Link(NamedTuple):
    """A rigid body.

    Attributes:
        name: on the robot.
        mass: zero for a frame without a body.
        centre: of mass.
        box: lower and upper corner of the visible collision box; None for no box.
        colour: key of `COLOURS`.
        decor: visible boxes without contacts, with their colours.
    """

    name: str
    mass: float = 0.0
    centre: Vector = (0.0, 0.0, 0.0)
    box: tuple[Vector, Vector] | None = None
    colour: str = "white"
    decor: tuple[tuple[Vector, Vector, str], ...] = ()


DARK = "dark"
COLOURS = {"white": "0.92 0.92 0.9 1", "grey": "0.45 0.46 0.48 1", DARK: "0.15 0.15 0.17 1"}
INF = float("inf")
X, Y, Z = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)
DOWN = (0.0, 0.0, -1.0)
FINGER_LENGTH, FINGER_OFFSET = 0.09137, 0.00495  # from a finger's joint to its tip's, along x and outwards
MAX_GAP = 0.09
TOOL_FRAME = "r_gripper_tool_frame"

# The head with its cameras, the folded left arm and the wheels, without contacts.
TORSO_DECOR = (
    ((-0.13, -0.07, 0.314), (0.0, 0.07, 0.42), DARK),
    ((-0.17, -0.16, 0.42), (0.06, 0.16, 0.56), "white"),
    ((0.06, -0.13, 0.45), (0.075, 0.13, 0.53), DARK),
    ((-0.1, 0.264, -0.1), (0.14, 0.40, 0.12), "white"),
    ((-0.04, 0.30, -0.45), (0.10, 0.42, -0.1), "grey"),
    ((0.0, 0.30, -0.45), (0.36, 0.42, -0.33), "white"),
)
WHEELS = tuple(
    ((x - 0.075, y - 0.05, -0.05), (x + 0.075, y + 0.05, 0.07), DARK) for x in (-0.225, 0.225) for y in (-0.3, 0.3)
)
LINKS = (
    Link("base_footprint"),
    Link("base_link", 116.0, (-0.061, 0.0, 0.2), ((-0.334, -0.334, 0.0), (0.334, 0.334, 0.656)), decor=WHEELS),
    Link(
        "torso_lift_link",
        36.25,
        (-0.1, 0.0, 0.0),
        ((-0.288, -0.264, -0.506), (0.112, 0.264, 0.314)),
        "grey",
        TORSO_DECOR,
    ),
    Link("r_shoulder_pan_link", 25.8),
    Link("r_shoulder_lift_link", 2.75, (0.022, 0.0, 0.0)),
    Link("r_upper_arm_roll_link", 0.1),
    Link("r_upper_arm_link", 6.018, (0.214, 0.0, 0.0), ((-0.05, -0.077, -0.085), (0.484, 0.077, 0.085))),
    Link("r_elbow_flex_link", 1.903),
    Link("r_forearm_roll_link", 0.1),
    Link("r_forearm_link", 2.58, (0.188, 0.0, 0.0), ((0.095, -0.06, -0.06), (0.357, 0.06, 0.06)), "grey"),
    Link("r_wrist_flex_link", 0.614),
    Link("r_wrist_roll_link", 0.1),
    Link("r_gripper_palm_link", 0.58, (0.066, 0.0, 0.0), ((0.029, -0.05, -0.024), (0.125, 0.05, 0.024))),
    Link(TOOL_FRAME),
    Link("r_gripper_l_finger_link", 0.17, (0.04, 0.015, 0.0), ((-0.009, -0.009, -0.028), (0.095, 0.046, 0.028)), DARK),
    Link("r_gripper_r_finger_link", 0.17, (0.04, -0.015, 0.0), ((-0.009, -0.046, -0.028), (0.095, 0.009, 0.028)), DARK),
    # The gripping faces match the formula of the gap.
    Link("r_gripper_l_finger_tip_link", 0.044, (0.0, 0.005, 0.0), ((-0.026, -0.01495, -0.011), (0.031, 0.029, 0.011))),
    Link("r_gripper_r_finger_tip_link", 0.044, (0.0, -0.005, 0.0), ((-0.026, -0.029, -0.011), (0.031, 0.01495, 0.011))),
)


def _revolute(name: str, parent: str, child: str, origin: Vector, axis: Vector, limits: Limits) -> Joint:
    """Make a joint of the right arm."""
    kind = "revolute" if limits[0] > -INF else "continuous"
    return Joint(f"r_{name}_joint", kind, parent, child, origin, axis, *limits)


TORSO = Joint(
    "torso_lift_joint", "prismatic", "base_link", "torso_lift_link", (-0.05, 0, 0.739675), Z, 0.0, 0.33, 1e4, 0.013, 2e4
)
ARM = tuple(
    _revolute(name, f"{parent}_link", f"r_{name}_link", origin, axis, limits)
    for name, parent, origin, axis, limits in (
        ("shoulder_pan", "torso_lift", (0.0, -0.188, 0.0), Z, (-2.2854, 0.7146, 30.0, 2.088, 10.0)),
        ("shoulder_lift", "r_shoulder_pan", (0.1, 0.0, 0.0), Y, (-0.5236, 1.3963, 30.0, 2.082, 10.0)),
        ("upper_arm_roll", "r_shoulder_lift", (0.0, 0.0, 0.0), X, (-3.9, 0.8, 30.0, 3.27, 0.1)),
        ("elbow_flex", "r_upper_arm", (0.4, 0.0, 0.0), Y, (-2.3213, 0.0, 30.0, 3.30, 1.0)),
        ("forearm_roll", "r_elbow_flex", (0.0, 0.0, 0.0), X, (-INF, INF, 30.0, 3.6, 0.1)),
        ("wrist_flex", "r_forearm", (0.321, 0.0, 0.0), Y, (-2.18, 0.0, 10.0, 3.078, 0.1)),
        ("wrist_roll", "r_wrist_flex", (0.0, 0.0, 0.0), X, (-INF, INF, 10.0, 3.6, 0.1)),
    )
)
FINGERS = tuple(
    _revolute(
        f"gripper_{side}_finger",
        "r_gripper_palm_link",
        f"r_gripper_{side}_finger_link",
        (0.07691, outwards * 0.01, 0.0),
        axis,
        (0.0, 0.548, 1000.0, 0.5, 0.02),
    )
    for side, outwards, axis in (("l", 1, Z), ("r", -1, DOWN))
)
TIPS = tuple(
    _revolute(
        f"gripper_{side}_finger_tip",
        f"r_gripper_{side}_finger_link",
        f"r_gripper_{side}_finger_tip_link",
        (FINGER_LENGTH, outwards * FINGER_OFFSET, 0.0),
        axis,
        (0.0, 0.548, 1000.0, 0.5, 0.001),
    )._replace(mimics=f"r_gripper_{side}_finger_joint")
    for side, outwards, axis in (("l", 1, DOWN), ("r", -1, Z))
)
TOOL_OFFSET = (0.18, 0.0, 0.0)
FIXED = tuple(
    Joint(name, "fixed", parent, child, origin)
    for name, parent, child, origin in (
        ("base_footprint_joint", "base_footprint", "base_link", (0.0, 0.0, 0.051)),
        ("r_upper_arm_joint", "r_upper_arm_roll_link", "r_upper_arm_link", (0.0, 0.0, 0.0)),
        ("r_forearm_joint", "r_forearm_roll_link", "r_forearm_link", (0.0, 0.0, 0.0)),
        ("r_gripper_palm_joint", "r_wrist_roll_link", "r_gripper_palm_link", (0.0, 0.0, 0.0)),
        ("r_gripper_tool_joint", "r_gripper_palm_link", TOOL_FRAME, TOOL_OFFSET),
    )
)
MOVING = (*ARM, *FINGERS, *TIPS)  # joints that move in an episode


def gap(angle: ArrayLike) -> Array:
    """Return the opening between the finger tips, in metres, at an angle of the finger joints."""
    q = np.asarray(angle)
    return np.asarray(2.0 * (FINGER_LENGTH * np.sin(q) + FINGER_OFFSET * np.cos(q) - FINGER_OFFSET))


def finger_angle(opening: ArrayLike) -> Array:
    """Return the angle of the finger joints at an opening: the inverse of `gap`."""
    height = np.asarray(opening) / 2.0 + FINGER_OFFSET
    reach = np.hypot(FINGER_LENGTH, FINGER_OFFSET)
    return np.asarray(np.arcsin(height / reach) - np.arctan2(FINGER_OFFSET, FINGER_LENGTH))


def urdf() -> str:
    """Return the robot's URDF, with one tag per line."""
    return document("pr2", COLOURS, LINKS, (*FIXED, TORSO, *MOVING))


def simulated_urdf(torso: float) -> str:
    """Return the URDF for the simulator, with a fixed torso and a mass for the fixed root.

    Args:
        torso: height of the torso in metres.
    """
    root, *links = (link for link in LINKS if link.name != TOOL_FRAME)
    joints = [joint for joint in (*FIXED, fixed_torso(torso), *MOVING) if joint.child != TOOL_FRAME]
    return document("pr2", COLOURS, (root._replace(mass=1.0), *links), joints)


def fixed_torso(height: float) -> Joint:
    """Return the torso's joint fixed at a height in metres."""
    x, y, z = TORSO.origin
    return Joint(TORSO.name, "fixed", TORSO.parent, TORSO.child, (x, y, z + height))


def document(name: str, colours: Mapping[str, str], links: Iterable[Link], joints: Iterable[Joint]) -> str:
    """Return the URDF of links and joints; `colours` maps a name to red, green, blue and opacity."""
    tags = [f'<material name="{colour}"><color rgba="{rgba}"/></material>' for colour, rgba in colours.items()]
    tags += [tag for link in links for tag in _link_tags(link)]
    tags += [tag for joint in joints for tag in _joint_tags(joint)]
    return "\n".join(['<?xml version="1.0"?>', f'<robot name="{name}">', *tags, "</robot>", ""])


def _link_tags(link: Link) -> list[str]:
    return [f'<link name="{link.name}">', *_inertial_tags(link), *_shape_tags(link), "</link>"]


def _joint_tags(joint: Joint) -> list[str]:
    tags = [
        f'<joint name="{joint.name}" type="{joint.kind}">',
        f'<parent link="{joint.parent}"/>',
        f'<child link="{joint.child}"/>',
        f'<origin xyz="{_text(joint.origin)}" rpy="0 0 0"/>',
    ]
    if joint.kind != "fixed":
        position = "" if joint.kind == "continuous" else f'lower="{joint.lower}" upper="{joint.upper}" '
        tags += [
            f'<axis xyz="{_text(joint.axis)}"/>',
            f'<limit {position}effort="{joint.effort}" velocity="{joint.velocity}"/>',
            f'<dynamics damping="{joint.damping}"/>',
        ]
    if joint.mimics:
        tags.append(f'<mimic joint="{joint.mimics}"/>')
    return [*tags, "</joint>"]


def _inertial_tags(link: Link) -> list[str]:
    """Return the inertial tags, with the inertia of the box, or of a small cube if there is none."""
    if link.mass == 0.0:
        return []
    size = np.full(3, 0.08) if link.box is None else np.subtract(link.box[1], link.box[0])
    xx, yy, zz = link.mass * (np.sum(size**2) - size**2) / 12.0
    return [
        "<inertial>",
        f'<origin xyz="{_text(link.centre)}"/>',
        f'<mass value="{link.mass}"/>',
        f'<inertia ixx="{xx:.9g}" iyy="{yy:.9g}" izz="{zz:.9g}" ixy="0" ixz="0" iyz="0"/>',
        "</inertial>",
    ]


def _shape_tags(link: Link) -> list[str]:
    decor = [tag for low, high, colour in link.decor for tag in _visual_tags(_box_tags(low, high), colour)]
    if link.box is None:
        return decor
    box = _box_tags(*link.box)
    return [*_visual_tags(box, link.colour), *decor, "<collision>", *box, "</collision>"]


def _visual_tags(shape: list[str], colour: str) -> list[str]:
    return ["<visual>", *shape, f'<material name="{colour}"/>', "</visual>"]


def _box_tags(low: Vector, high: Vector) -> list[str]:
    size = np.subtract(high, low)
    origin = f'<origin xyz="{_text(np.add(low, high) / 2)}"/>'
    return [origin, "<geometry>", f'<box size="{_text(size)}"/>', "</geometry>"]


def _text(values: ArrayLike) -> str:
    return " ".join(f"{value:.9g}" for value in np.asarray(values, dtype=np.float64))
