"""Measure how many episodes the defaults need if a task is written down in other ways.

Each finished curve is stored in docs/results/descriptions/ at once, with the description in place of the learner, and
returns in the units of the task as written. The same command continues after an interruption.
"""

import os

os.environ["OMP_NUM_THREADS"] = "1"

import sys
from argparse import Namespace
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

import tasks
from command import ended, parser
from described import DESCRIPTIONS, SUBJECTS, name_of
from rkhs_ros.rollouts.environments import time_limit
from rkhs_ros.runs.config import config_for
from task_table import PAGE, RESULTS, Cell, page_with
from trial import Curves, Key, Point, Trial, as_csv, read_curves

FILES = RESULTS.parent / "descriptions"
FILE, TABLE = FILES / "curves.csv", FILES / "table.csv"
BEGIN = "<!-- made by benchmarks/descriptions.py -->\n"
QUICK = {"tasks": ["pendulum"], "descriptions": ["as-written"], "seeds": "300"}


def learnt(key: Key, trial: Trial) -> tuple[Key, list[Point] | str]:
    """Train on the description that the key names; return its curve, or the error if it failed."""
    _, result = tasks.learnt(key._replace(learner="ours"), trial)
    return key, result if isinstance(result, str) else [_as_written(point, key) for point in result]


def _as_written(point: Point, key: Key) -> Point:
    """Return a point with undiscounted returns in the units of the task as written; others depend on the steps."""
    how, steps = DESCRIPTIONS[key.learner], SUBJECTS[key.task].steps
    returns = ((each - how.offset * steps) / how.factor for each in (point.undiscounted_return, point.least_return))
    undiscounted, least = returns
    return point._replace(undiscounted_return=undiscounted, least_return=least, discounted_return=float("nan"))


def asked(options: Namespace, curves: Curves) -> Iterator[tuple[Key, Trial]]:
    """Yield the missing curves, seed by seed."""
    for seed in options.seeds:
        for task in options.tasks:
            for how in options.descriptions:
                key, episodes = Key(task, how, seed), 2 if options.quick else SUBJECTS[task].written.episodes
                if DESCRIPTIONS[how].applies(SUBJECTS[task]) and key not in curves:
                    name = name_of(task, how)
                    changes = (f"seed={seed}", f"iterations={episodes}")
                    yield key, Trial(config_for(name, time_limit(name), changes), episodes)


class Line(NamedTuple):
    """The runs with one description of a task, medians.

    Attributes:
        task: name of the task.
        description: name of the description.
        runs: number of runs.
        reached: number of those that reached the threshold.
        episodes: episodes until the threshold, as text.
        last_return: return at the end.
    """

    task: str
    description: str
    runs: int
    reached: int
    episodes: str
    last_return: float


def lines_of(curves: Curves) -> list[Line]:
    """Return the lines of the tables."""
    lines = []
    for task, subject in SUBJECTS.items():
        for how in DESCRIPTIONS:
            if its := [curve for key, curve in curves.items() if key[:2] == (task, how)]:
                cell = Cell(subject.written, its)
                last = float(np.median(cell.scores("return")))
                lines.append(Line(task, how, len(its), cell.reached(), cell.median(), last))
    return lines


def table(lines: Sequence[Line]) -> str:
    """Return the table as CSV."""
    return as_csv(
        [name.replace("_", " ") for name in Line._fields],
        (line._replace(last_return=f"{line.last_return:.4g}") for line in lines),
    )


def summary(lines: Sequence[Line]) -> str:
    """Return the table in Markdown, with the tasks side by side."""
    names = [f"`{task}`, {subject.written.thresholds[0]:g} | At the end" for task, subject in SUBJECTS.items()]
    rows = [f"| Description | {' | '.join(names)} |", "|---" * (1 + 2 * len(names)) + "|"]
    found = {line[:2]: _shown(line) for line in lines}
    for how in DESCRIPTIONS:
        rows.append(f"| {how} | {' | '.join(found.get((task, how), '- | -') for task in SUBJECTS)} |")
    return "\n".join([*rows, ""])


def _shown(line: Line) -> str:
    some = "" if line.reached == line.runs else f" ({line.reached} of {line.runs})"
    return f"{line.episodes}{some} | {line.last_return:.1f}"


def run(options: Namespace) -> int:
    """Train the missing curves, store each, and print the table; return the exit code.

    The table and that of the page are made of its own curves alone.
    """
    missing = asked(options, read_curves(options.curves))
    known = {name: subject.written for name, subject in SUBJECTS.items()}
    code = tasks.train_and_store(learnt, missing, options, known)
    lines = lines_of(read_curves(options.curves))
    print(table(lines), end="")
    if options.curves == FILE.resolve():
        page = page_with(summary(lines), BEGIN)
        TABLE.write_text(table(lines))
        PAGE.write_text(page)
    return code


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command; return its exit code."""
    choices: dict[str, Mapping[str, Any]] = {"tasks": SUBJECTS, "descriptions": DESCRIPTIONS}
    how: dict[str, Any] = {"seeds": "300-302", "curves": FILE, "quick": QUICK}
    return ended(lambda: run(tasks.options_of(parser(__doc__), arguments, choices, **how)))


if __name__ == "__main__":
    from descriptions import main as run_main  # by the name under which worker processes import it

    sys.exit(run_main())
