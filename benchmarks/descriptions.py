"""Measure how the episodes that a task needs depend on how the task is written down.

The defaults of ``rkhs train --env`` learn the same tasks with other units, rates, angles, columns and delays. Each
curve is written to a file named by a hash of everything that it depends on, so the same command continues after an
interruption. A run stops 3 episodes after its evaluation return first reaches the threshold of its task.
"""

from __future__ import annotations

import os
import sys
from argparse import Namespace
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import Any, NamedTuple

os.environ["OMP_NUM_THREADS"] = "1"

from command import parsed, parser
from described import DESCRIPTIONS, TASKS, environment_id
from descriptions_table import Row, as_csv, as_markdown
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
from trial import Point, Trial, read_curve

EPISODES = 12
AFTERWARDS = 3  # episodes after the first one that reaches the threshold
LEARNER = replace(LEARNERS["ours"], scripts=("trial.py", "described.py", "described_tasks.py", "described_wrappers.py"))
TABLES: dict[str, Mapping[str, Any]] = {"tasks": TASKS, "descriptions": DESCRIPTIONS}
QUICK = {"tasks": ["pendulum-wrap"], "descriptions": ["as-written", "degrees"], "seeds": "200", "episodes": 1}


class Place(NamedTuple):
    """The place of a curve in the table, and its file."""

    task: str
    description: str
    path: Path
    trial: Trial

    @property
    def threshold(self) -> float:
        """Threshold of the undiscounted return."""
        return DESCRIPTIONS[self.description].threshold(TASKS[self.task])


def trial_of(task: str, description: str, seed: int, episodes: int) -> Trial:
    """Return the trial of a description of a task."""
    environment = environment_id(task, description)
    changes = (f"seed={seed}", f"iterations={episodes}")
    return Trial(config_for(environment, time_limit(environment), changes), episodes, discounted=False)


def places(options: Namespace) -> Iterator[Place]:
    """Yield the requested curves of tasks whose packages are installed, and report the other tasks."""
    for task in options.tasks:
        if absent := missing(TASKS[task].packages):
            print(f"skipped: {task}: expected {', '.join(absent)} to be installed", file=sys.stderr)
            continue
        applicable = [name for name in options.descriptions if DESCRIPTIONS[name].applies(TASKS[task])]
        for description, seed in product(applicable, options.seeds):
            trial = trial_of(task, description, seed, options.episodes)
            key = LEARNER.key(trial, TASKS[task].packages)
            name = f"{task}_{description}_{seed}_{key}.csv"
            yield Place(task, description, options.out / "curves" / name, trial)


def until_reached(points: Iterable[Point], threshold: float) -> Iterator[Point]:
    """Yield points until some episodes after the first one whose return reaches the threshold."""
    last = float("inf")
    for point in points:
        yield point
        if point.undiscounted_return >= threshold:
            last = min(last, point.episodes + AFTERWARDS)
        if point.episodes >= last:
            return


def learn_into(path: Path, trial: Trial, threshold: float) -> Outcome:
    """Train until the threshold and a few episodes more, and store the curve."""
    return store_curve(path, lambda: until_reached(LEARNER.learn(trial), threshold))


def rows_of(asked: Sequence[Place]) -> list[Row]:
    """Return a row of the table for each description of a task with a finished curve."""
    rows = []
    for task, description in dict.fromkeys((place.task, place.description) for place in asked):
        found = [p for p in asked if (p.task, p.description) == (task, description) and p.path.exists()]
        if found:
            how = DESCRIPTIONS[description]
            threshold = TASKS[task].threshold
            curves = [
                [(p.episodes, how.original_return(TASKS[task], p.undiscounted_return)) for p in read_curve(each.path)]
                for each in found
            ]
            rows.append(Row(task, description, threshold, curves))
    return rows


def run(options: Namespace) -> int:
    """Train the missing curves and write the table; return the exit code."""
    asked = list(places(options))
    (options.out / "curves").mkdir(parents=True, exist_ok=True)
    work = [(place.path, place.trial, place.threshold) for place in asked if not place.path.exists()]
    try:
        return train_missing(learn_into, work, options, title="descriptions")
    finally:
        rows = rows_of(asked)
        write_table(options.out, as_csv(rows), as_markdown(rows))


def options_of(arguments: Sequence[str] | None) -> Namespace:
    """Parse the options.

    Raises:
        ValueError: a name is unknown, or a number does not fit.
    """
    command = parser(__doc__)
    add_arguments(command, "descriptions", "200-204", **TABLES)
    command.add_argument("--episodes", type=int, default=EPISODES, help=f"budget of a run; default: {EPISODES}")
    options = parsed(command, arguments, **QUICK)
    check_options(options, **TABLES)
    require(options.episodes >= 1, "--episodes", "at least 1", options.episodes)
    return options


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command; return its exit code."""
    return exit_code(lambda: run(options_of(arguments)))


if __name__ == "__main__":
    exit_with(main)
