"""Motions of the PR2's arm and gripper: the demonstration, its changes, and the kinematics that they need.

The demonstration approaches the lever (1.2 s), closes the gripper (0.5 s), turns the lever by 45 degrees (1.3 s), pulls
the door by 16 degrees (2.5 s) and holds it (0.3 s).
"""

from dataclasses import dataclass, fields
from functools import cache
from importlib.resources import files
from typing import NamedTuple
from xml.etree import ElementTree

import numpy as np
from numpy.typing import ArrayLike

from sim_nodes.envs.scene import Array

FILE = "demonstration.npz"
RATE = 20  # Hz, of knots
SECONDS = 5.8
TOOL_OFFSET = (0.18, 0.0, 0.0)  # m, from the palm to the middle between the finger tips
FINGER_LENGTH, FINGER_OFFSET = 0.09137, 0.00495  # m, from a finger's joint to its tip's, along x and outwards
MAX_GAP = 0.09  # m
TOLERANCE = 1e-6  # of the solver, in metres and radians
REACHED = 1e-4  # accepted error of a solution, in metres and radians


class Joint(NamedTuple):
    """A revolute or fixed joint; origin and axis, of shape (3,), are in the parent's frame; all frames are parallel."""

    name: str
    is_fixed: bool
    origin: Array
    axis: Array
    lower: float  # -inf for no limit
    upper: float
    effort: float  # greatest torque, N m
    velocity: float  # rad/s


def _joint(element: ElementTree.Element) -> Joint:
    parts = {name: {} if (part := element.find(name)) is None else part.attrib for name in ("origin", "axis", "limit")}
    origin, axis = (np.array(parts[name].get("xyz", "0 0 0").split(), dtype=float) for name in ("origin", "axis"))
    limits = {"lower": -np.inf, "upper": np.inf, "effort": 0.0, "velocity": 0.0}
    numbers = [float(parts["limit"].get(name, value)) for name, value in limits.items()]
    return Joint(element.get("name", ""), element.get("type") == "fixed", origin, axis, *numbers)


_JOINTS = tuple(map(_joint, ElementTree.fromstring(files(__package__).joinpath("pr2.urdf").read_text()).iter("joint")))
MOVING = tuple(joint for joint in _JOINTS if not joint.is_fixed)
ARM, FINGERS, TIPS = MOVING[:7], MOVING[7:9], MOVING[9:]


def rotation_about(axis: Array | tuple[float, float, float], angles: Array) -> Array:
    """Return the rotation matrices, shape (k, 3, 3), for angles of shape (k,) about one unit axis."""
    x, y, z = axis
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    sine, versine = np.sin(angles)[:, None, None], (1.0 - np.cos(angles))[:, None, None]
    return np.asarray(np.eye(3) + sine * cross + versine * (cross @ cross))


def gap(angle: ArrayLike) -> Array:
    """Return the opening between the finger tips, in metres, at an angle of the finger joints."""
    q = np.asarray(angle)
    return np.asarray(2.0 * (FINGER_LENGTH * np.sin(q) + FINGER_OFFSET * np.cos(q) - FINGER_OFFSET))


def finger_angle(opening: ArrayLike) -> Array:
    """Return the angle of the finger joints at an opening: the inverse of `gap`."""
    height = np.asarray(opening) / 2.0 + FINGER_OFFSET
    reach = np.hypot(FINGER_LENGTH, FINGER_OFFSET)
    return np.asarray(np.arcsin(height / reach) - np.arctan2(FINGER_OFFSET, FINGER_LENGTH))


@dataclass(frozen=True)
class Chain:
    """A chain of revolute joints whose frames are parallel at zero angles."""

    origins: Array  # of each joint in the previous frame, shape (n, 3)
    axes: Array  # of each joint, unit vectors, shape (n, 3)
    lower: Array  # least angles, shape (n,)
    upper: Array  # greatest angles, shape (n,)
    tool: Array  # position in the last frame, shape (3,)

    def forward(self, q: Array) -> tuple[Array, Array]:
        """Return positions (k, 3) and rotation matrices (k, 3, 3) of the tool at angles of shape (k, n)."""
        position, rotation, _, _ = self._frames(q)
        return position, rotation

    def solve(self, start: Array, position: Array, rotation: Array, iterations: int = 40) -> tuple[Array, Array]:
        r"""Find angles at which the tool is at a position and rotation, by damped least squares.

        .. math:: q \leftarrow q + J^\top (J J^\top + \lambda^2 I)^{-1} e, \qquad \lambda^2 = 10^{-5} + 0.1 \|e\|^2

        Angles stay within their limits. Return those of the k independent problems, and the norms of their errors.
        """
        q = np.clip(start, self.lower, self.upper)
        for _ in range(iterations):
            at, turned, jacobian = self.forward_and_jacobian(q)
            error = np.concatenate([position - at, _rotation_error(turned, rotation)], axis=1)
            if np.max(np.abs(error)) < TOLERANCE:
                break
            damping = 1e-5 + 0.1 * np.sum(error**2, axis=1)
            square = jacobian @ jacobian.swapaxes(1, 2) + damping[:, None, None] * np.eye(6)
            step = (jacobian.swapaxes(1, 2) @ np.linalg.solve(square, error[:, :, None]))[:, :, 0]
            q = np.clip(q + step, self.lower, self.upper)
        at, turned = self.forward(q)
        error = np.concatenate([position - at, _rotation_error(turned, rotation)], axis=1)
        return q, np.sqrt(np.sum(error**2, axis=1))

    def forward_and_jacobian(self, q: Array) -> tuple[Array, Array, Array]:
        """Return also the derivatives of the position and the rotation vector, shape (k, 6, n), see `forward`."""
        position, rotation, points, axes = self._frames(q)
        linear = np.cross(axes, position[:, None, :] - points)
        return position, rotation, np.concatenate([linear, axes], axis=2).swapaxes(1, 2)

    def _frames(self, q: Array) -> tuple[Array, Array, Array, Array]:
        """Return the tool's position and rotation, and the joints' points and axes (k, n, 3) in the base frame."""
        position, rotation = np.zeros((len(q), 3)), np.tile(np.eye(3), (len(q), 1, 1))
        points, axes = np.empty((*q.shape, 3)), np.empty((*q.shape, 3))
        for i, (origin, axis) in enumerate(zip(self.origins, self.axes, strict=True)):
            position = position + rotation @ origin
            points[:, i], axes[:, i] = position, rotation @ axis
            rotation = rotation @ rotation_about(axis, q[:, i])
        return position + rotation @ self.tool, rotation, points, axes


@cache
def arm_chain() -> Chain:
    """Return the chain of the right arm from the base footprint to the tool."""
    origins = np.array([joint.origin for joint in ARM])
    base, torso = (
        next(joint for joint in _JOINTS if joint.name == f"{name}_joint") for name in ("base_footprint", "torso_lift")
    )
    origins[0] += torso.origin + base.origin
    return Chain(
        origins,
        np.array([joint.axis for joint in ARM]),
        np.array([joint.lower for joint in ARM]),
        np.array([joint.upper for joint in ARM]),
        np.array(TOOL_OFFSET),
    )


@dataclass(frozen=True)
class Demonstration:
    """The demonstrated motion, in the frame of the robot's base at its nominal pose, which is the world frame."""

    times: Array  # seconds of the knots, shape (k,)
    arm: Array  # angles, shape (k, 7)
    openings: Array  # metres between the finger tips, shape (k,)
    positions: Array  # of the tool, shape (k, 3)
    rotations: Array  # of the tool, shape (k, 3, 3)


@cache
def demonstration() -> Demonstration:
    """Return the demonstration, which is stored with this module."""
    with files(__package__).joinpath(FILE).open("rb") as file, np.load(file) as arrays:
        return Demonstration(**{field.name: arrays[field.name] for field in fields(Demonstration)})


@dataclass(frozen=True)
class Motion:
    """A motion of the arm and gripper, at the demonstration's knots."""

    arm: Array  # angles, shape (k, 7)
    openings: Array  # metres between the finger tips, shape (k,)


def adapted(original: Demonstration, action: Array) -> Motion | None:
    """Return the demonstration changed by an action; None if the arm cannot reach it.

    The action is a shift of the tool's y along the whole path, in the frame of the robot's base, and a change of the
    opening, both in metres; the opening is clipped to the gripper's range.
    """
    positions = original.positions + np.array([0.0, action[0], 0.0])
    arm, errors = arm_chain().solve(original.arm, positions, original.rotations)
    if not np.all(errors < REACHED):
        return None
    return Motion(arm, np.clip(original.openings + action[1], 0.0, MAX_GAP))


def _rotation_error(rotation: Array, wanted: Array) -> Array:
    """Return half the sum of the cross products of the axes, an approximation of the rotation vector."""
    return np.asarray(0.5 * np.cross(rotation, wanted, axis=1).sum(axis=2))
