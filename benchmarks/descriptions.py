"""Measure how many episodes the defaults need if a task is written down in other ways.

Each finished curve is stored in docs/results/descriptions/ at once, with the description in place of the learner, and
returns in the units of the task as written. The same command continues after an interruption.
"""

import os

os.environ["OMP_NUM_THREADS"] = "1"

import csv
import sys
from argparse import Namespace
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

import tasks
from command import ended, parsed, parser
from described import DESCRIPTIONS, SUBJECTS, name_of
from rkhs_ros.app.study import add_jobs_argument, parse_seeds
from rkhs_ros.base.validation import pick
from rkhs_ros.rollouts.environments import time_limit
from rkhs_ros.runs.config import config_for
from task_table import PAGE, RESULTS, Cell, page_with
from trial import Curves, Key, Point, Trial, as_csv, read_curves

FILES = RESULTS.parent / "descriptions"
FILE, TABLE = FILES / "curves.csv", FILES / "table.csv"
BEGIN = "<!-- made by benchmarks/descriptions.py -->\n"
HEAD = ("task", "description", "runs", "reached", "episodes", "last return")
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


def table(curves: Curves) -> str:
    """Return, as CSV, the episodes until the threshold and the last return of each description: medians."""
    lines = []
    for task, subject in SUBJECTS.items():
        for how in DESCRIPTIONS:
            if its := [curve for key, curve in curves.items() if key[:2] == (task, how)]:
                cell = Cell(subject.written, its)
                until, last = cell.counts(subject.written.thresholds[0], "episodes"), cell.scores("return")
                reached = int(np.isfinite(until).sum())
                lines.append((task, how, len(its), reached, f"{np.median(until):g}", f"{np.median(last):.4g}"))
    return as_csv(HEAD, lines)


def summary(made: str) -> str:
    """Return a table in Markdown of one in CSV, with the tasks side by side."""
    found = {(line[0], line[1]): line[2:] for line in csv.reader(made.splitlines()[1:])}
    names = [f"`{task}`, {subject.written.thresholds[0]:g} | At the end" for task, subject in SUBJECTS.items()]
    lines = [f"| Description | {' | '.join(names)} |", "|---" * (1 + 2 * len(names)) + "|"]
    for how in DESCRIPTIONS:
        cells = [_shown(*found[task, how]) if (task, how) in found else "- | -" for task in SUBJECTS]
        lines.append(f"| {how} | {' | '.join(cells)} |")
    return "\n".join([*lines, ""])


def _shown(runs: str, reached: str, episodes: str, last: str) -> str:
    number = "never" if episodes == "inf" else episodes
    return f"{number}{'' if reached == runs else f' ({reached} of {runs})'} | {float(last):.1f}"


def run(options: Namespace) -> int:
    """Train the missing curves, store each, and print the table; return the exit code.

    The table and that of the page are made of its own curves alone.
    """
    missing = asked(options, read_curves(options.curves))
    known = {name: subject.written for name, subject in SUBJECTS.items()}
    code = tasks.train_and_store(learnt, missing, options, known)
    made = table(read_curves(options.curves))
    print(made, end="")
    if options.curves == FILE.resolve():
        page = page_with(summary(made), BEGIN)
        TABLE.write_text(made)
        PAGE.write_text(page)
    return code


def options_of(arguments: Sequence[str] | None) -> Namespace:
    """Parse the options.

    Raises:
        ValueError: a name is unknown, or the seeds are no numbers.
    """
    command = parser(__doc__)
    for kind, known in (("tasks", SUBJECTS), ("descriptions", DESCRIPTIONS)):
        command.add_argument(f"--{kind}", nargs="+", default=list(known), help="default: all, " + ", ".join(known))
    command.add_argument("--seeds", default="300-302", help="such as 300-304 or 300,302; default: 300-302")
    command.add_argument("--curves", type=Path, default=FILE, help="file of the curves")
    command.add_argument("--quiet", action="store_true", help="no progress bar")
    add_jobs_argument(command)
    options = parsed(command, arguments, **QUICK)
    for each in options.tasks:
        pick(each, SUBJECTS, "task")
    for each in options.descriptions:
        pick(each, DESCRIPTIONS, "description")
    options.seeds, options.curves = parse_seeds(options.seeds), options.curves.resolve()
    return options


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command; return its exit code."""
    return ended(lambda: run(options_of(arguments)))


if __name__ == "__main__":
    from descriptions import main as run_main  # by the name under which worker processes import it

    sys.exit(run_main())
