"""Motions of the arm that modify the demonstration."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray

from sim_nodes.pr2.demonstration import TORSO, Demonstration
from sim_nodes.pr2.kinematics import Chain, arm_chain
from sim_nodes.pr2.robot import MAX_GAP

Array = NDArray[np.float64]

REACHED = 1e-4  # accepted error of a solution, in metres and radians


@dataclass(frozen=True)
class Motion:
    """A motion of the arm and gripper, at the demonstration's knots.

    Attributes:
        arm: angles of the arm, shape (k, 7).
        openings: metres between the finger tips, shape (k,).
    """

    arm: Array
    openings: Array


def adapted(demonstration: Demonstration, action: Array) -> Motion | None:
    """Return the demonstration changed by an action; None if the arm cannot reach it.

    Args:
        demonstration: the original motion.
        action: shift of the tool's y along the whole path, in the frame of the robot's base, and change of the opening,
            in metres; the opening is clipped to the gripper's range.
    """
    positions = demonstration.positions + np.array([0.0, action[0], 0.0])
    arm, errors = _chain().solve(demonstration.arm, positions, demonstration.rotations)
    if not np.all(errors < REACHED):
        return None
    return Motion(arm, np.clip(demonstration.openings + action[1], 0.0, MAX_GAP))


@cache
def _chain() -> Chain:
    return arm_chain(TORSO)
