"""Draw the reward and the success of the PR2 over a grid of actions, for three poses.

``python benchmarks/pr2_map.py [--out FILE.png]`` takes about a minute. It prints the share of the actions that open the
door and the median time of an episode, and writes the picture only with ``--out``.
"""

from __future__ import annotations

import os
import time
from pathlib import Path

os.environ["OMP_NUM_THREADS"] = "1"

import matplotlib as mpl

mpl.use("Agg")

import matplotlib.pyplot as plt
import numpy as np

from command import needing, parser

with needing("pybullet", "pip install pybullet"):
    from sim_nodes.pr2.environment import POSE_SD, PR2Door

POSES = {
    "as demonstrated": np.zeros(3),
    "all errors one sd": POSE_SD,
    "nearer, to the right, turned left": POSE_SD * np.array([1.0, -1.0, 1.0]),
}
COLUMNS, ROWS = 15, 13


def survey(
    task: PR2Door, pose: np.ndarray, shifts: np.ndarray, openings: np.ndarray
) -> tuple[np.ndarray, np.ndarray, list[float]]:
    """Return rewards and successes, shape (openings, shifts), and the seconds of the episodes."""
    shape, seconds = (len(openings), len(shifts)), []
    rewards, opened = np.empty(shape), np.empty(shape, dtype=bool)
    for row, opening in enumerate(openings):
        for column, shift in enumerate(shifts):
            begin = time.process_time()
            outcome = task.attempt(pose, np.array([shift, opening]))
            seconds.append(time.process_time() - begin)
            rewards[row, column], opened[row, column] = outcome.reward, outcome.success
    return rewards, opened, seconds


def axes(task: PR2Door, columns: int, rows: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the shifts of the columns and the openings of the rows."""
    space = task.single_action_space
    return np.linspace(space.low[0], space.high[0], columns), np.linspace(space.low[1], space.high[1], rows)


def main(path: Path | None, *, quick: bool) -> None:
    """Draw the maps, write them if there is a path, and print the figures."""
    task = PR2Door()
    shifts, openings = axes(task, *((2, 2) if quick else (COLUMNS, ROWS)))
    figure, panels = plt.subplots(1, len(POSES), figsize=(14, 4), sharey=True, layout="constrained")
    for panel, (name, pose) in zip(panels, POSES.items(), strict=True):
        rewards, opened, seconds = survey(task, pose, shifts, openings)
        columns, rows = np.meshgrid(shifts - task.start[0], openings - task.start[1])  # as actions
        mesh = panel.pcolormesh(columns, rows, rewards, vmin=0.0, vmax=1.0, cmap="viridis")
        panel.plot(columns[opened], rows[opened], "w.", markersize=5)
        panel.set(title=f"{name}: {opened.mean():.0%} open it", xlabel=task.action_names[0])
        print(
            f"{name:35s} {opened.mean():5.1%} of the changes open the door, best reward {rewards.max():.3f},"
            f" {np.median(seconds):.3f} s an episode"
        )
    panels[0].set_ylabel(task.action_names[1])
    figure.colorbar(mesh, label="reward (dots: the door is open)")
    if path is not None:
        figure.savefig(path, dpi=120)
        print(path)


if __name__ == "__main__":
    command = parser(__doc__)
    command.add_argument("--out", type=Path, metavar="FILE.png", help="file for the picture (none)")
    options = command.parse_args()
    main(options.out, quick=options.quick)
