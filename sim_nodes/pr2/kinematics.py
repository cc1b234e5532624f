"""Forward and inverse kinematics of a chain of revolute joints, for many configurations at once."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sim_nodes.pr2.robot import ARM, TOOL_OFFSET, Vector, fixed_torso

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Chain:
    """A chain of revolute joints whose frames are parallel at zero angles.

    Attributes:
        origins: of each joint in the previous frame, shape (n, 3).
        axes: of each joint, unit vectors, shape (n, 3).
        lower: least angles, shape (n,).
        upper: greatest angles, shape (n,).
        tool: position of the tool in the last frame, shape (3,).
    """

    origins: Array
    axes: Array
    lower: Array
    upper: Array
    tool: Array

    def forward(self, q: Array) -> tuple[Array, Array]:
        """Return positions (k, 3) and rotation matrices (k, 3, 3) of the tool at angles of shape (k, n)."""
        position, rotation, _, _ = self._frames(q)
        return position, rotation

    def jacobian(self, q: Array) -> Array:
        """Return the derivatives of position and rotation vector, shape (k, 6, n)."""
        return self._forward_and_jacobian(q)[2]

    def solve(self, start: Array, position: Array, rotation: Array, iterations: int = 40) -> tuple[Array, Array]:
        r"""Find angles at which the tool is at a position and rotation, by damped least squares.

        .. math:: q \leftarrow q + J^\top (J J^\top + \lambda^2 I)^{-1} e, \qquad \lambda^2 = 10^{-5} + 0.1 \|e\|^2

        Angles stay within their limits. The k problems are independent.

        Args:
            start: initial angles, shape (k, n).
            position: shape (k, 3).
            rotation: shape (k, 3, 3).
            iterations: at most.

        Returns:
            The angles, shape (k, n), and the norms of the remaining errors, in metres and radians, shape (k,).
        """
        q = np.clip(start, self.lower, self.upper)
        for _ in range(iterations):
            at, turned, jacobian = self._forward_and_jacobian(q)
            error = np.concatenate([position - at, _rotation_error(turned, rotation)], axis=1)
            if np.max(np.abs(error)) < TOLERANCE:
                break
            q = np.clip(q + _damped_step(jacobian, error), self.lower, self.upper)
        at, turned = self.forward(q)
        error = np.concatenate([position - at, _rotation_error(turned, rotation)], axis=1)
        return q, np.sqrt(np.sum(error**2, axis=1))

    def _forward_and_jacobian(self, q: Array) -> tuple[Array, Array, Array]:
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


TOLERANCE = 1e-6  # of the solver, in metres and radians


def rotation_about(axis: Array | Vector, angles: Array) -> Array:
    """Return the rotation matrices, shape (k, 3, 3), for angles of shape (k,) about one unit axis."""
    x, y, z = axis
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    sine, versine = np.sin(angles)[:, None, None], (1.0 - np.cos(angles))[:, None, None]
    return np.asarray(np.eye(3) + sine * cross + versine * (cross @ cross))


def arm_chain(torso: float) -> Chain:
    """Return the chain of the right arm from the base footprint to the tool, for a torso height in metres."""
    origins = np.array([joint.origin for joint in ARM])
    origins[0] += np.add(fixed_torso(torso).origin, (0.0, 0.0, 0.051))
    return Chain(
        origins,
        np.array([joint.axis for joint in ARM]),
        np.array([joint.lower for joint in ARM]),
        np.array([joint.upper for joint in ARM]),
        np.array(TOOL_OFFSET),
    )


def _damped_step(jacobian: Array, error: Array) -> Array:
    damping = 1e-5 + 0.1 * np.sum(error**2, axis=1)
    square = jacobian @ jacobian.swapaxes(1, 2) + damping[:, None, None] * np.eye(6)
    return np.asarray((jacobian.swapaxes(1, 2) @ np.linalg.solve(square, error[:, :, None]))[:, :, 0])


def _rotation_error(rotation: Array, wanted: Array) -> Array:
    """Return half the sum of the cross products of the axes, an approximation of the rotation vector."""
    return np.asarray(0.5 * np.cross(rotation, wanted, axis=1).sum(axis=2))
