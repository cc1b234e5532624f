"""Measure how many episodes learners need on a table of tasks.

Each finished curve is stored in docs/results/tasks/ at once. So the same command continues after an interruption, and
trains only the curves that are missing there. The table and the pictures of the page are made from that file.
"""

import os

os.environ["OMP_NUM_THREADS"] = "1"

import sys
from argparse import ArgumentParser, Namespace
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from command import ended, parsed, parser
from rkhs_ros.app.study import add_jobs_argument, parse_seeds
from rkhs_ros.base.endings import FAILED, deferred_signals
from rkhs_ros.base.processes import one_thread
from rkhs_ros.base.validation import pick, require
from rkhs_ros.rollouts.environments import time_limit
from rkhs_ros.runs.config import config_for
from rkhs_ros.studies.workers import run_parallel
from task_learners import LEARNERS, missing
from task_pictures import draw
from task_table import PAGE, RESULTS, TABLE, Cell, cells_of, page_with, shown, summary, text_of_table
from trial import TASKS, Curves, Key, Point, Task, Trial, add_curves, read_curves

CURVES = RESULTS / "curves.csv"
BUDGET = 100  # episodes of learners without a model
TABLES: dict[str, Mapping[str, Any]] = {"tasks": TASKS, "learners": LEARNERS}
Learn = Callable[[Key, Trial], tuple[Key, list[Point] | str]]  # returns the curve, or the error if it failed
QUICK = {"tasks": ["cart-pole"], "learners": ["linear-cma-es"], "seeds": "100"}


def repeat_of(curves: Curves, task: str, learner: str) -> int | None:
    """Return the action repeat of the other runs of a learner on a task, or the median of ours; None without any."""
    for name in (learner, "ours"):
        if chosen := [curve for key, curve in curves.items() if key[:2] == (task, name)]:
            return int(Cell(TASKS[task], chosen).action_repeat)
    return None


def trial_of(task: Task, learner: str, seed: int, repeat: int = 1) -> Trial:
    """Return the trial of a learner, which holds actions for a number of steps if it does not choose that."""
    budget = task.episodes if LEARNERS[learner].has_model else BUDGET
    changes = (*task.changes, *LEARNERS[learner].changes, f"seed={seed}", f"iterations={budget}")  # at most
    config = config_for(task.environment, time_limit(task.environment), changes)
    return Trial(config, budget, task.discounted, repeat, task.success)


def is_skipped(task: str, learner: str) -> bool:
    """Return whether packages of a task or a learner are missing, and report it."""
    absent = missing((*TASKS[task].packages, *LEARNERS[learner].packages))
    if absent:
        print(f"skipped: {task} by {learner}: expected {', '.join(absent)} to be installed", file=sys.stderr)
    return bool(absent)


def asked(options: Namespace, curves: Curves) -> Iterator[tuple[Key, Trial]]:
    """Yield the missing curves whose packages are installed, and report the others."""
    for task in options.tasks:
        for learner in options.learners:
            chosen, repeat = LEARNERS[learner], repeat_of(curves, task, learner)
            if is_skipped(task, learner):
                continue
            if chosen.holds_actions and (repeat is None or repeat == 1):
                why = "ours to be run first" if repeat is None else "an action repeat other than 1"
                print(f"skipped: {task} by {learner}: expected {why}", file=sys.stderr)
                continue
            for key in (Key(task, learner, seed) for seed in options.seeds):
                if key in curves:
                    continue
                trial = trial_of(TASKS[task], learner, key.seed, (chosen.holds_actions and repeat) or 1)
                if trial.episodes * trial.config.training.horizon <= chosen.waits:
                    why = f"more than {chosen.waits} steps, after which it begins to learn"
                    print(f"skipped: {task} by {learner}: expected {why}", file=sys.stderr)
                    break
                yield key, trial


@one_thread()
def learnt(key: Key, trial: Trial) -> tuple[Key, list[Point] | str]:
    """Train a learner; return its curve, or the error if it failed."""
    try:
        return key, list(LEARNERS[key.learner].learn(trial))
    except Exception as error:  # a failed run must not end the others
        return key, " ".join(f"{type(error).__name__}: {error}".split())


def reached(key: Key, curve: Sequence[Point], task: Task) -> str:
    """Return a line on when a curve reached the thresholds of its task."""
    cell = Cell(task, [curve])
    counts = [f"of {value:g}: {shown(cell.until(value, 'episodes'))}" for value in task.thresholds]
    return f"{key.task} by {key.learner}, seed {key.seed}: episodes until a return {', '.join(counts)}"


def train_and_store(
    learn: Learn, asked_for: Iterable[tuple[Key, Trial]], options: Namespace, known: Mapping[str, Task] = TASKS
) -> int:
    """Train each curve once, store it when it is finished, and return the exit code."""
    work = list(dict(asked_for).items())
    options.curves.parent.mkdir(parents=True, exist_ok=True)
    if work:
        add_curves(options.curves, {})  # fails before the training rather than after it
    else:
        print("nothing to train")
    failed = False
    for key, result in run_parallel(learn, work, jobs=options.jobs, title="curves", quiet=options.quiet):
        if isinstance(result, str):
            failed = True
            print(f"failed: {' '.join(map(str, key))}: {result}", file=sys.stderr)
        else:
            with deferred_signals():  # an interruption must not lose a finished curve
                add_curves(options.curves, {key: result})
            print(reached(key, result, known[key.task]), flush=True)
    return FAILED if failed else 0


def make_table(curves: Curves) -> None:
    """Write the table, the part of the page, and the pictures."""
    cells = cells_of(curves)
    table, page, pictures = text_of_table(cells), page_with(summary(cells)), draw(cells)
    TABLE.write_text(table)  # now that all can be made
    PAGE.write_text(page)
    for name, figure in pictures.items():
        figure.savefig(RESULTS / f"{name}.png", dpi=100)


def run(options: Namespace) -> int:
    """Train the missing curves, and store each, or make the table of all; return the exit code.

    The page is made of its own curves alone; of another file, the table is printed.
    """
    curves = read_curves(options.curves)
    if options.table:
        require(len(curves) > 0, f"{options.curves}", "a file of curves", "none")
        if options.curves == CURVES.resolve():
            make_table(curves)
        else:
            print(summary(cells_of(curves)))
        return 0
    return train_and_store(learnt, asked(options, curves), options)


def options_of(
    command: ArgumentParser,
    arguments: Sequence[str] | None,
    choices: Mapping[str, Mapping[str, Any]],
    *,
    seeds: str,
    curves: Path,
    quick: Mapping[str, Any],
) -> Namespace:
    """Declare and parse the options of a command that stores curves.

    Args:
        command: made by `parser`.
        arguments: the arguments; those of the process if None.
        choices: what can be chosen, by the option's name in the plural; the default is all.
        seeds: the default.
        curves: the default.
        quick: defaults that ``--quick`` uses instead.

    Raises:
        ValueError: a name is unknown, or the seeds are no numbers.
    """
    for kind, known in choices.items():
        command.add_argument(f"--{kind}", nargs="+", default=list(known), help="default: all, " + ", ".join(known))
    command.add_argument("--seeds", default=seeds, help=f"such as 0-9 or 0,2,5; default: {seeds}")
    command.add_argument("--curves", type=Path, default=curves, help="file of the curves; default: that of the page")
    command.add_argument("--quiet", action="store_true", help="no progress bar")
    add_jobs_argument(command)
    options = parsed(command, arguments, **quick)
    for kind, known in choices.items():
        for name in getattr(options, kind):
            pick(name, known, kind.removesuffix("s"))
    options.seeds, options.curves = parse_seeds(options.seeds), options.curves.resolve()
    return options


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command; return its exit code."""
    command = parser("How many episodes learners need on a table of tasks.")
    command.add_argument("--table", action="store_true", help="train nothing; make table, page and pictures")
    return ended(lambda: run(options_of(command, arguments, TABLES, seeds="100-104", curves=CURVES, quick=QUICK)))


if __name__ == "__main__":
    from tasks import main as run_main  # by the name under which worker processes import it

    sys.exit(run_main())
