"""Drawings and bodies of the cart-pole swing-up."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from sim_nodes.envs.vector_task import BLUE, DARK, GREEN, ORANGE, PALE, Array, Body, BodyTrajectories, upright

if TYPE_CHECKING:
    from matplotlib.axes import Axes

REACH = 0.5  # m, of the tip of the pole from its joint
DRAWN_HALF = 1.0  # m, of the drawn rail on each side if the task has no limit
FLOOR = -0.62  # m
METRES_PER_NEWTON = 0.05  # of the arrow
BEADS = 8  # in the row that visualises the force
RING = 0.1  # m, radius of the drawn target
CART_SIZE = (0.3, 0.16, 0.12)  # m


def draw(axes: Axes, state: Array, force: float, rail: float | None) -> None:
    """Draw a state, the force in it, and the target of the tip; the picture widens for a cart that leaves it."""
    x, angle = float(state[0]), float(state[2])
    half = rail or DRAWN_HALF
    left, right = min(-half, x - REACH), max(half, x + REACH)
    ends = (left, right) if rail is None else (-rail, rail)
    axes.plot([left, right], [FLOOR, FLOOR], color=PALE, linewidth=2)
    axes.plot(ends, [0.0, 0.0], color=PALE, linewidth=5, solid_capstyle="butt")
    axes.plot([0.0, 0.0], [FLOOR, FLOOR + 0.06], color=DARK, linewidth=2)  # the middle of the rail
    turn = np.linspace(0.0, 2 * np.pi, 60)
    axes.plot(RING * np.sin(turn), REACH + RING * np.cos(turn), color=GREEN, linewidth=3)
    axes.text(-1.5 * RING, REACH, "target", ha="right", va="center", color=GREEN, fontsize=12)
    width, _, height = CART_SIZE
    axes.fill_between([x - width / 2, x + width / 2], -height / 2, height / 2, color=DARK, zorder=3)
    tip = x + REACH * np.sin(angle), -REACH * np.cos(angle)
    axes.plot([x, tip[0]], [0.0, tip[1]], color=BLUE, linewidth=6, solid_capstyle="round", zorder=4)
    axes.plot(*tip, "o", color=BLUE, markersize=12, zorder=4)
    end = x + METRES_PER_NEWTON * force
    axes.plot([x, end], [-0.17, -0.17], color=ORANGE, linewidth=3)
    axes.plot(x, 0.0, "o", color=PALE, markersize=5, zorder=5)
    axes.plot(end, -0.17, ">" if force > 0 else "<", color=ORANGE, markersize=8)
    axes.text(0.97, 0.96, f"force {force:+.1f} N", ha="right", va="top", fontsize=12, transform=axes.transAxes)
    axes.set_xlim(left - 0.1, right + 0.1, auto=True)
    axes.set_ylim(-0.7, 0.85, auto=True)
    axes.set_aspect("equal", adjustable="datalim")  # may extend either range, which `auto` permits


def bodies(rail: float | None) -> list[Body]:
    """Return the rail, the floor, the cart, the pole and its tip, the target, and the force as a row of beads."""
    length = 2 * (rail or DRAWN_HALF)
    beads = [Body("ball", (size, size, size), ORANGE) for size in [*[0.03] * (BEADS - 1), 0.07]]
    return [
        Body("box", (length, 0.05, 0.03), PALE),
        Body("box", (length, 0.6, 0.01), PALE),
        Body("box", CART_SIZE, DARK),
        Body("cylinder", (0.03, 0.03, REACH), BLUE),
        Body("ball", (0.08, 0.08, 0.08), BLUE),
        Body("ball", (0.1, 0.1, 0.1), GREEN),
        *beads,
    ]


def motion(times: Array, states: Array, forces: Array) -> BodyTrajectories:
    """Return the trajectories of the bodies for states of shape (k, 4) and forces of shape (k,)."""
    x, angle, zero = states[:, 0], states[:, 2], 0 * states[:, 0]
    across, up = np.sin(angle), -np.cos(angle)
    row = x[:, None] + METRES_PER_NEWTON * np.linspace(0.0, 1.0, BEADS) * forces[:, None]
    along = np.stack([zero, zero, x, x + REACH / 2 * across, x + REACH * across, zero], axis=1)
    heights = np.stack([zero, zero + FLOOR, zero, REACH / 2 * up, REACH * up, zero + REACH], axis=1)
    along = np.concatenate([along, row], axis=1)
    heights = np.concatenate([heights, np.full_like(row, -0.17)], axis=1)
    depth = np.array([0.0, 0.0, 0.0, -0.12, -0.12, -0.12, *[-0.12] * BEADS])  # in front of the cart
    positions = np.stack([along, np.broadcast_to(depth, along.shape), heights], axis=2)
    orientations = np.array(upright(positions))
    orientations[:, 3, 0], orientations[:, 3, 2] = np.sin(angle / 2), np.cos(angle / 2)  # z points from joint to tip
    return BodyTrajectories(times, positions, orientations)
