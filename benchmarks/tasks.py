"""Measure how many episodes learners need on a table of tasks.

Each curve is written to a file named by a hash of everything that it depends on. So the same command continues after
an interruption, and repeats only the curves affected by changed settings or code.
"""

from __future__ import annotations

import os
import sys
from argparse import Namespace
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

os.environ["OMP_NUM_THREADS"] = "1"

from command import parsed, parser
from rkhs_ros.base.validation import require
from rkhs_ros.rollouts.environments import time_limit
from rkhs_ros.runs.config import config_for
from stored_curves import (
    Outcome,
    add_arguments,
    check_options,
    exit_code,
    exit_with,
    store_curve,
    train_missing,
    write_table,
)
from task_learners import LEARNERS, missing
from tasks_table import Cell, as_csv, as_markdown
from trial import Trial, read_curve


@dataclass(frozen=True)
class Task:
    """A task of the table.

    Attributes:
        environment: Gymnasium id.
        thresholds: thresholds of the evaluation return.
        episodes: budget of each learner.
        changes: settings that the task needs besides its horizon.
        discounted: whether the thresholds are for the discounted return.
        packages: packages that must be installed.
    """

    environment: str
    thresholds: tuple[float, ...]
    episodes: int = 100
    changes: tuple[str, ...] = ()
    discounted: bool = False
    packages: tuple[str, ...] = ()

    def trial(self, learner: str, seed: int, episodes: int | None) -> Trial:
        """Return the trial of a learner."""
        budget = episodes or self.episodes
        changes = (*self.changes, *LEARNERS[learner].changes, f"seed={seed}", f"iterations={budget}")  # at most
        config = config_for(self.environment, time_limit(self.environment), changes)
        return Trial(config, budget, self.discounted)


CLIP, WRAP = (f"environment.options.angle={at_the_ends}" for at_the_ends in ("clip", "wrap"))
ANGLE, WINDOW = "inputs.angles=[0]", "inputs.history=5"
SWUNG_UP = (45.0, 50.0)  # of 51.8 at best
TASKS = {
    "Pendulum-v1": Task("Pendulum-v1", (-150.0, -138.0), episodes=150),
    "MountainCarContinuous-v0": Task("MountainCarContinuous-v0", (0.0, 90.0)),
    "InvertedPendulum-v5": Task("InvertedPendulum-v5", (900.0, 999.0), packages=("mujoco",)),
    "Reacher-v5": Task("Reacher-v5", (-7.0, -6.0, -5.3), episodes=300, packages=("mujoco",)),
    "Swimmer-v5": Task("Swimmer-v5", (30.0, 100.0), packages=("mujoco",)),
    "toy": Task("rkhs/Toy-v0", (14.0, 14.2), discounted=True),
    "pendulum-clip": Task("rkhs/Pendulum-v0", SWUNG_UP, changes=(CLIP,), discounted=True),
    "pendulum-wrap": Task("rkhs/Pendulum-v0", SWUNG_UP, changes=(WRAP, ANGLE), discounted=True),
    "pendulum-pomdp": Task("rkhs/PendulumPOMDP-v0", SWUNG_UP, changes=(ANGLE, WINDOW), discounted=True),
    "cart-pole": Task("rkhs/CartPoleSwingUp-v0", (45.0, 48.0)),
    "pr2-door": Task(
        "rkhs/PR2Door-v0", (0.5, 0.8), changes=("environment.options.pose=per_episode",), packages=("pybullet",)
    ),
}
TABLES: dict[str, Mapping[str, Any]] = {"tasks": TASKS, "learners": LEARNERS}
QUICK = {"tasks": ["toy"], "learners": ["ours", "linear-ars"], "seeds": "100", "episodes": 1}


class Place(NamedTuple):
    """The place of a curve in the table, and its file."""

    task: str
    learner: str
    seed: int
    path: Path
    trial: Trial


def places(options: Namespace) -> Iterator[Place]:
    """Yield the requested curves whose packages are installed, and report the others."""
    for name in options.tasks:
        for learner in options.learners:
            task, chosen = TASKS[name], LEARNERS[learner]
            if absent := missing((*task.packages, *chosen.packages)):
                print(f"skipped: {name} by {learner}: expected {', '.join(absent)} to be installed", file=sys.stderr)
                continue
            for seed in options.seeds:
                trial = task.trial(learner, seed, options.episodes)
                key = chosen.key(trial, task.packages)
                yield Place(name, learner, seed, options.out / "curves" / f"{name}_{learner}_{seed}_{key}.csv", trial)


def cells_of(asked: Sequence[Place]) -> list[Cell]:
    """Return a cell of the table for each task and learner with a finished curve."""
    curves: dict[tuple[str, str], list[Place]] = {}
    for place in asked:
        if place.path.exists():
            curves.setdefault((place.task, place.learner), []).append(place)
    return [
        Cell(task, learner, TASKS[task].thresholds, TASKS[task].discounted, [read_curve(p.path) for p in found])
        for (task, learner), found in curves.items()
    ]


def learn_into(path: Path, learner: str, trial: Trial) -> Outcome:
    """Train a learner and store the curve."""
    return store_curve(path, lambda: LEARNERS[learner].learn(trial))


def run(options: Namespace) -> int:
    """Train the missing curves and write the table; return the exit code."""
    asked = list(places(options))
    (options.out / "curves").mkdir(parents=True, exist_ok=True)
    work = [(place.path, place.learner, place.trial) for place in asked if not place.path.exists()]
    try:
        return train_missing(learn_into, work, options, title="tasks")
    finally:
        cells = cells_of(asked)
        write_table(options.out, as_csv(cells), as_markdown(cells))


def options_of(arguments: Sequence[str] | None) -> Namespace:
    """Parse the options.

    Raises:
        ValueError: a name is unknown, or a number does not fit.
    """
    command = parser("How many episodes learners need on a table of tasks.")
    add_arguments(command, "tasks", "0-9", **TABLES)
    command.add_argument("--episodes", type=int, help="budget of each learner; default: the task's")
    options = parsed(command, arguments, **QUICK)
    check_options(options, **TABLES)
    require(options.episodes is None or options.episodes >= 1, "--episodes", "at least 1", options.episodes)
    return options


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command; return its exit code."""
    return exit_code(lambda: run(options_of(arguments)))


if __name__ == "__main__":
    exit_with(main)
