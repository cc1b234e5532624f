"""The demonstration: approach the lever, close the gripper, turn the lever, pull the door, hold.

``python -m sim_nodes.pr2.demonstration`` computes it once; the package contains the result as data.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from functools import cache
from importlib.resources import files
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from sim_nodes.pr2 import door
from sim_nodes.pr2.kinematics import arm_chain, rotation_about

Array = NDArray[np.float64]

TORSO = 0.15  # m
RATE = 20  # Hz
APPROACH, CLOSE, TURN, PULL, HOLD = 1.2, 0.5, 1.3, 2.5, 0.3  # s
SECONDS = APPROACH + CLOSE + TURN + PULL + HOLD
APPROACH_LENGTH = 0.10  # m
OPEN, CLOSED = 0.06, 0.016  # m between the finger tips
GRASP, DEPTH = 0.075, 0.012  # m: distance of the tool from the lever's pivot, and beyond its middle
LEVER_TURN, DOOR_TURN = np.deg2rad(45.0), np.deg2rad(16.0)
UPRIGHT = np.pi / 2  # roll at which the fingers are above and below the lever
# Initial guess of the arm's angles, far from its limits: the elbow is below and outwards.
SEED = np.array([-0.35, 0.43, -0.8, -1.38, 3.09, -0.84, -0.82])
FILE = "demonstration.npz"


@dataclass(frozen=True)
class Demonstration:
    """The demonstrated motion, in the frame of the robot's base at its nominal pose, which is the world frame.

    Attributes:
        times: seconds of the knots, shape (k,).
        arm: angles of the arm, shape (k, 7).
        openings: metres between the finger tips, shape (k,).
        positions: of the tool, shape (k, 3).
        rotations: of the tool, shape (k, 3, 3).
    """

    times: Array
    arm: Array
    openings: Array
    positions: Array
    rotations: Array


@cache
def load() -> Demonstration:
    """Load the demonstration stored with this module."""
    with files(__package__).joinpath(FILE).open("rb") as file, np.load(file) as arrays:
        return Demonstration(**{field.name: arrays[field.name] for field in fields(Demonstration)})


def make() -> Demonstration:
    """Compute the demonstration from its phases.

    Raises:
        ValueError: the arm cannot follow the path.
    """
    times = np.arange(round(RATE * SECONDS) + 1) / RATE
    starts = np.cumsum([0.0, APPROACH, CLOSE, TURN])
    durations = (APPROACH, CLOSE, TURN, PULL)
    approach, close, turn, pull = (
        minimum_jerk((times - start) / duration) for start, duration in zip(starts, durations, strict=True)
    )
    positions, rotations = tool_path(APPROACH_LENGTH * (1.0 - approach), LEVER_TURN * turn, DOOR_TURN * pull)
    openings = OPEN + (CLOSED - OPEN) * close
    return Demonstration(times, _arm_path(positions, rotations), openings, positions, rotations)


def tool_path(distance: Array, lever: Array, opened: Array) -> tuple[Array, Array]:
    """Return the tool's positions (k, 3) and rotations (k, 3, 3) relative to the lever.

    Args:
        distance: metres in front of the lever, shape (k,).
        lever: angle of the lever, shape (k,).
        opened: angle of the door, shape (k,).
    """
    zero = np.zeros_like(lever)
    along = np.stack([DEPTH - distance, GRASP * np.cos(lever), -GRASP * np.sin(lever)], axis=1)
    turned = rotation_about((0.0, 0.0, -1.0), opened)
    arms = np.add(door.PIVOT, along) - door.HINGE
    positions = door.HINGE + np.einsum("kij,kj->ki", turned, arms)
    return positions, turned @ rotation_about((-1.0, 0.0, 0.0), lever) @ rotation_about((1.0, 0.0, 0.0), zero + UPRIGHT)


def minimum_jerk(phase: Array) -> Array:
    """Return the progress, from 0 to 1, of a minimum-jerk motion at a phase, which is clipped to [0, 1]."""
    s = np.clip(phase, 0.0, 1.0)
    return np.asarray(s**3 * (10.0 - 15.0 * s + 6.0 * s**2))


def _arm_path(positions: Array, rotations: Array) -> Array:
    """Solve the inverse kinematics of the knots in order, each starting from the previous solution."""
    chain, q, path = arm_chain(TORSO), SEED[None], []
    for position, rotation in zip(positions, rotations, strict=True):
        q, error = chain.solve(q, position[None], rotation[None], iterations=300)
        if error[0] > 1e-5:
            raise ValueError(
                f"demonstration: expected a path that the arm can follow, got an error of {error[0]:.1g} m"
            )
        path.append(q[0])
    return np.array(path)


def main() -> None:
    """Compute the demonstration, and write it to the package."""
    made = make()
    np.savez(Path(__file__).with_name(FILE), **{field.name: getattr(made, field.name) for field in fields(made)})


if __name__ == "__main__":
    main()
