"""The drives of an arm, which follow set points smoothly and supervise limits."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rkhs_ros.rkhs.kernels import Array
from sim_nodes.robots.robot import SECOND_PUBLISHER, TOLERANCE, Protection

LIMITED = ("position", "step", "velocity", "acceleration")
KINDS = ("malformed", "non_finite", *LIMITED, SECOND_PUBLISHER)
BANDWIDTH = 15.0  # 1/s, of the critically damped filter between set points and motion
BRAKE = 20.0  # rad/s² of each joint


@dataclass(frozen=True)
class JointCommand:
    """Successive set points of joints."""

    names: tuple[str, ...]  # other joints keep their set points; empty for all joints in order
    times: tuple[float, ...]  # seconds since the arrival of the command
    positions: tuple[tuple[float, ...], ...]  # rad, a point for each time, with one number per name unless malformed


@dataclass(frozen=True)
class DriveLimits:
    """Limits of the protective stop in rad, rad/s and rad/s², each of shape (n,); a step is a jump of the set point."""

    lower: Array
    upper: Array
    velocity: Array
    acceleration: Array
    step: Array


@dataclass(frozen=True)
class Drives:
    r"""The state of an arm's drives.

    The motion :math:`x` follows the set points :math:`c` by :math:`\ddot x = w^2 (c - x) - 2 w \dot x`.
    """

    joints: tuple[str, ...]
    limits: DriveLimits
    position: Array  # rad, shape (n,)
    velocity: Array  # rad/s, shape (n,)
    time: float = 0.0  # s
    set_points: tuple[Array, Array] | None = None  # s and rad; None while stopped, when the brakes hold
    protection: Protection = field(default_factory=lambda: Protection(dict.fromkeys(KINDS, 0)))

    @cached_property
    def target(self) -> Array:
        """Current set point, rad, shape (n,)."""
        if self.set_points is None:
            return self.position
        times, positions = self.set_points
        return np.array([np.interp(self.time, times, column) for column in positions.T])

    @property
    def acceleration(self) -> Array:
        """Acceleration while the drives are on, rad/s², shape (n,)."""
        return np.asarray(BANDWIDTH**2 * (self.target - self.position) - 2 * BANDWIDTH * self.velocity)

    def heard(self, command: JointCommand) -> Drives:
        """Return the state after a command arrives: the drives follow it, or it triggers the protective stop."""
        if (violation := self._misshapen(command)) is not None:
            return self.tripped(*violation)
        times, positions = np.array(command.times), self._ordered(command)
        if (violation := self._violation(times, positions)) is not None:
            return self.tripped(*violation)
        if self.protection.is_stopped:
            return self
        knots = np.concatenate([[self.target], positions])
        return replace(self, set_points=(self.time + np.concatenate([[0.0], times]), knots))

    def stepped(self, seconds: float) -> Drives:
        """Return the state after a time, exact for a constant set point."""
        if self.set_points is None:
            return self._braked(seconds)
        error = self.position - self.target
        slope = self.velocity + BANDWIDTH * error
        decay = np.exp(-BANDWIDTH * seconds)
        position = self.target + (error + slope * seconds) * decay
        velocity = (self.velocity - BANDWIDTH * slope * seconds) * decay
        after = replace(self, position=position, velocity=velocity, time=self.time + seconds)
        return after._supervised()

    def tripped(self, kind: str, reason: str) -> Drives:
        """Return the state after a violation: the brakes are on."""
        return replace(self, set_points=None, protection=self.protection.tripped(kind, reason))

    def reset(self) -> Drives:
        """Return the state with the protective stop reset; the brakes hold until the next command."""
        return replace(self, protection=self.protection.reset())

    def _braked(self, seconds: float) -> Drives:
        velocity = np.sign(self.velocity) * np.maximum(np.abs(self.velocity) - BRAKE * seconds, 0.0)
        position = self.position + 0.5 * (self.velocity + velocity) * seconds
        return replace(self, position=position, velocity=velocity, time=self.time + seconds)

    def _supervised(self) -> Drives:
        for kind, unit in (("velocity", "rad/s"), ("acceleration", "rad/s²")):
            values, limits = getattr(self, kind), getattr(self.limits, kind)
            if (broken := self._first(_exceed(values, limits))) is not None:
                return self.tripped(
                    kind,
                    f"{self.joints[broken]}: expected at most {limits[broken]:g} {unit}, got {abs(values[broken]):.4g}",
                )
        return self

    def _misshapen(self, command: JointCommand) -> tuple[str, str] | None:
        """Return kind and reason if a command is malformed; None if it is valid."""
        names = command.names or self.joints
        if len(set(names) & set(self.joints)) != len(names):
            return "malformed", f"expected positions of some of {', '.join(self.joints)}, got {', '.join(names)}"
        sizes = {len(row) for row in command.positions}
        if sizes != {len(names)}:
            return "malformed", f"expected points of {len(names)} positions, got {sorted(sizes)}"
        if command.times[0] < 0.0 or any(np.diff(command.times) <= 0.0):
            return "malformed", f"expected increasing times from 0 on, got {command.times}"
        return None

    def _ordered(self, command: JointCommand) -> Array:
        """Return the positions in the order of the joints, shape (k, n)."""
        positions = np.tile(self.target, (len(command.times), 1))
        positions[:, [self.joints.index(name) for name in command.names or self.joints]] = command.positions
        return positions

    def _violation(self, times: Array, positions: Array) -> tuple[str, str] | None:
        """Return the kind and the reason of the first limit that the set points violate; None if there is none."""
        limits = self.limits
        if not np.isfinite(positions).all():
            return "non_finite", "expected finite positions, got nan or infinity"
        outside = (positions < limits.lower - TOLERANCE) | (positions > limits.upper + TOLERANCE)
        if (broken := self._first(outside)) is not None:
            got = positions[outside.any(axis=1)][0, broken]
            low, high = limits.lower[broken], limits.upper[broken]
            return "position", f"{self.joints[broken]}: expected {low:g} to {high:g} rad, got {got:g}"
        steps = np.diff(positions, axis=0, prepend=[self.target])
        room = limits.step + limits.velocity * np.diff(times, prepend=0.0)[:, None]
        # A stopped arm has no set point, so there is no step to the next one.
        if not self.protection.is_stopped and (broken := self._first(_exceed(steps, room))) is not None:
            worst = int(np.argmax(np.abs(steps[:, broken]) - room[:, broken]))
            got, most = abs(steps[worst, broken]), room[worst, broken]
            return "step", f"{self.joints[broken]}: expected at most {most:g} rad, got {got:g}"
        return None

    @staticmethod
    def _first(broken: ArrayLike) -> int | None:
        """Return the first joint (last axis) for which any flag is true; None if there is none."""
        joints = np.flatnonzero(np.atleast_2d(broken).any(axis=0))
        return int(joints[0]) if joints.size else None


def _exceed(values: Array, limits: Array) -> NDArray[np.bool_]:
    """Return whether magnitudes exceed limits by more than rounding, elementwise."""
    return np.asarray(np.abs(values) > limits * (1.0 + TOLERANCE))
