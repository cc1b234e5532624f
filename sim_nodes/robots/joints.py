"""Readings of a robot's joints."""

from __future__ import annotations

from typing import NamedTuple


class JointReadings(NamedTuple):
    """Readings of all joints at one time, as in `sensor_msgs/JointState`.

    Attributes:
        names: of the joints.
        positions: rad.
        velocities: rad/s.
        efforts: N m.
    """

    names: tuple[str, ...]
    positions: tuple[float, ...]
    velocities: tuple[float, ...]
    efforts: tuple[float, ...]
