"""A door with a hinge on the robot's left, and a latch that its lever releases.

Units are metres, radians, kilograms and newtons, in the world frame. The hinge has a vertical axis at `HINGE`.
"""

from __future__ import annotations

import math

from sim_nodes.pr2.robot import Joint, Link, document

WIDTH, HEIGHT, THICKNESS = 0.90, 2.03, 0.04
SURFACE_X = 0.93  # of the robot's side
PIVOT = (SURFACE_X - 0.05, -0.26, 0.95)  # of the lever, in the middle of its depth
BACKSET = 0.06  # from the free edge to the pivot
LEVER_LENGTH, LEVER_HEIGHT, LEVER_DEPTH = 0.12, 0.020, 0.014
HINGE = (SURFACE_X, PIVOT[1] - BACKSET + WIDTH, 0.0)
TRAVEL = math.radians(55.0)  # of the lever
UNLATCHED = math.radians(30.0)  # angle of the lever above which the latch releases
SHUT = math.radians(0.5)  # angle of the door below which the latch engages
OPENED = math.radians(5.0)  # angle of the door that counts as success
# Hinges, seal and closer: 22 N at the free edge, the greatest force that ADA 404.2.9 allows indoors. A gripper that
# holds the lever pulls harder; a single finger that slides along it does not.
HINGE_FRICTION, HINGE_DAMPING = 20.0, 1.0
LEVER_DAMPING = 0.05
RETURN_SPEED = 5.0  # of the released lever
LATCH_TORQUE = 2000.0
LEVER_FRICTION, PANEL_FRICTION = 0.6, 0.5  # of the surfaces
COLOURS = {"wood": "0.62 0.45 0.28 1", "steel": "0.75 0.77 0.8 1", "post": "0.3 0.2 0.12 1", "wall": "0.85 0.87 0.82 1"}

# The frame and the wall around the door, without contacts.
_LEFT, _RIGHT, _BACK = HINGE[1] + 0.005, HINGE[1] - WIDTH - 0.005, SURFACE_X + 0.1
WALL = (
    ((SURFACE_X, _LEFT, 0.0), (_BACK, _LEFT + 0.08, HEIGHT + 0.08), "post"),
    ((SURFACE_X, _RIGHT - 0.08, 0.0), (_BACK, _RIGHT, HEIGHT + 0.08), "post"),
    ((SURFACE_X, _RIGHT, HEIGHT + 0.005), (_BACK, _LEFT, HEIGHT + 0.08), "post"),
    ((SURFACE_X + 0.02, _LEFT + 0.08, 0.0), (_BACK, _LEFT + 0.7, HEIGHT + 0.3), "wall"),
    ((SURFACE_X + 0.02, _RIGHT - 0.7, 0.0), (_BACK, _RIGHT - 0.08, HEIGHT + 0.3), "wall"),
    ((SURFACE_X + 0.02, _RIGHT - 0.7, HEIGHT + 0.08), (_BACK, _LEFT + 0.7, HEIGHT + 0.3), "wall"),
)
_PIVOT = (PIVOT[0] - HINGE[0], PIVOT[1] - HINGE[1], PIVOT[2])  # in the panel's frame
LINKS = (
    Link("frame", 1.0, decor=WALL),  # fixed
    Link(
        "panel",
        25.0,
        (THICKNESS / 2, -WIDTH / 2, HEIGHT / 2),
        ((0.0, -WIDTH, 0.0), (THICKNESS, 0.0, HEIGHT)),
        "wood",
    ),
    Link(
        "lever",
        0.3,
        (0.0, LEVER_LENGTH / 2, 0.0),
        ((-LEVER_DEPTH / 2, 0.0, -LEVER_HEIGHT / 2), (LEVER_DEPTH / 2, LEVER_LENGTH, LEVER_HEIGHT / 2)),
        "steel",
    ),
)
JOINTS = (
    # Angles increase as the door opens and as the lever goes down.
    Joint("door_hinge", "revolute", "frame", "panel", HINGE, (0.0, 0.0, -1.0), 0.0, 1.5, 1e4, 1e2, HINGE_DAMPING),
    Joint("door_lever", "revolute", "panel", "lever", _PIVOT, (-1.0, 0.0, 0.0), 0.0, TRAVEL, 1e4, 1e2, LEVER_DAMPING),
)


def urdf() -> str:
    """Return the door's URDF."""
    return document("door", COLOURS, LINKS, JOINTS)


def spring(lever: float) -> float:
    """Return the torque, in N m, that returns the lever from an angle."""
    return -(1.2 + 1.5 * max(lever, 0.0))


def latched(before: bool, door: float, lever: float) -> bool:
    """Return whether the latch holds the door, given its previous state and the angles."""
    if lever > UNLATCHED:
        return False
    return before or door < SHUT
