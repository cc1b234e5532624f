"""Measure how many episodes learners need on a table of tasks.

Each curve is written to a file named by a hash of everything that it depends on. So the same command continues after
an interruption, and repeats only the curves affected by changed settings or code.
"""

from __future__ import annotations

import os

os.environ["OMP_NUM_THREADS"] = "1"

import csv
import sys
from argparse import Namespace
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from io import StringIO
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from command import parsed, parser
from rkhs_ros.base.validation import require
from rkhs_ros.rollouts.environments import time_limit
from rkhs_ros.runs.config import config_for
from rkhs_ros.studies.aggregates import Estimate, mean_over_runs
from task_learners import LEARNERS, missing
from trial import (
    Outcome,
    Point,
    Trial,
    add_arguments,
    check_options,
    exit_code,
    exit_with,
    median_until,
    read_curve,
    store_curve,
    train_missing,
    write_table,
)

AFTER = (10, 30, 100)  # episodes
CAPTION = (
    "Real episodes and steps until the evaluation return, the mean of 10 episodes after an update, first reaches a\n"
    "threshold: median over the seeds, infinite where it is not reached. Mean return after so many episodes. Median\n"
    "CPU seconds of a run, without evaluations. In brackets 95 % intervals over the seeds by bootstrap."
)


@dataclass(frozen=True)
class Cell:
    """The curves of one learner on one task.

    Attributes:
        task: name of the task.
        learner: name of the learner.
        thresholds: thresholds of the return.
        discounted: whether they are for the discounted return.
        curves: one curve per seed.
    """

    task: str
    learner: str
    thresholds: tuple[float, ...]
    discounted: bool
    curves: Sequence[Sequence[Point]]

    def quantities(self) -> Iterator[Quantity]:
        """Yield the numbers that summarise the curves."""
        for threshold in self.thresholds:
            reached = np.array([self._reached(curve, threshold) for curve in self.curves])
            for name, values in zip(("episodes", "steps"), reached.T, strict=True):
                yield Quantity(f"{name} to", threshold, median_until(values))
        for episodes in AFTER:
            yield Quantity("return after", episodes, self._mean_return_after(episodes))
        yield Quantity("CPU seconds", None, median_until(np.array([curve[-1].cpu_seconds for curve in self.curves])))

    def _return(self, point: Point) -> float:
        return point.discounted_return if self.discounted else point.undiscounted_return

    def _reached(self, curve: Sequence[Point], threshold: float) -> tuple[float, float]:
        """Return episodes and steps at the first point with at least this return."""
        points = ((point.episodes, point.steps) for point in curve if self._return(point) >= threshold)
        return next(points, (np.inf, np.inf))

    def _mean_return_after(self, episodes: int) -> Estimate:
        """Return the mean over the runs at their last point within a number of episodes; nan if a run has none."""
        within = [[p for p in curve if p.episodes <= episodes] for curve in self.curves]
        if not all(within) or any(curve[-1].episodes < episodes for curve in self.curves):
            return Estimate(np.nan, np.nan, np.nan)
        return mean_over_runs(np.array([self._return(points[-1]) for points in within]))


class Quantity(NamedTuple):
    """One number of a cell: its name, its threshold or number of episodes, and its estimate."""

    name: str
    at: float | None
    estimate: Estimate

    @property
    def title(self) -> str:
        """Name in the header of a table."""
        return self.name if self.at is None else f"{self.name} {self.at:g}"


def as_csv(cells: Sequence[Cell]) -> str:
    """Return CSV with one line per number; unknown values are empty."""
    text = StringIO(newline="")
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(("task", "learner", "runs", "quantity", "at", "value", "low", "high"))
    for cell in cells:
        for name, at, estimate in cell.quantities():
            numbers = ("" if np.isnan(number) else number for number in estimate)
            writer.writerow((cell.task, cell.learner, len(cell.curves), name, "" if at is None else at, *numbers))
    return text.getvalue()


def as_markdown(cells: Sequence[Cell]) -> str:
    """Return one table per task, with a legend below."""
    tables = [
        _table(task, [cell for cell in cells if cell.task == task]) for task in dict.fromkeys(c.task for c in cells)
    ]
    return "\n".join([*tables, CAPTION, ""])


def _table(task: str, cells: Sequence[Cell]) -> str:
    quantities = [list(cell.quantities()) for cell in cells]
    rows = [["learner", "runs", *(quantity.title for quantity in quantities[0])]]
    rows += [
        [cell.learner, str(len(cell.curves)), *(_shown(quantity.estimate) for quantity in each)]
        for cell, each in zip(cells, quantities, strict=True)
    ]
    head, *body = (f"| {' | '.join(row)} |" for row in rows)
    kind = "discounted" if cells[0].discounted else "undiscounted"
    return "\n".join([f"**{task}** ({kind} return)", "", head, "|---" * len(rows[0]) + "|", *body, ""])


def _shown(estimate: Estimate) -> str:
    if np.isinf(estimate.value):
        return "not reached"
    return "-" if np.isnan(estimate.value) else str(estimate)


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
