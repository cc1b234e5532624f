"""What a robot's joints read."""

from __future__ import annotations

from typing import NamedTuple


class JointReadings(NamedTuple):
    """What the sensors of all joints read at a time, as in `sensor_msgs/JointState`.

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
