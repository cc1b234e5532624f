"""Measure how many episodes learners need on a table of tasks.

Each finished curve is stored in docs/results/tasks/ at once. So the same command continues after an interruption, and
trains only the curves that are missing there. The table and the pictures of the page are made from that file.
"""

import os

os.environ["OMP_NUM_THREADS"] = "1"

import csv
import signal
import sys
from argparse import Namespace
from collections.abc import Iterator, Mapping, Sequence
from io import StringIO
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from matplotlib.figure import Figure

from command import parsed, parser
from rkhs_ros.app.study import add_jobs_argument, parse_seeds
from rkhs_ros.base.endings import FAILED, INTERRUPTED, RunError, print_error
from rkhs_ros.base.processes import one_thread
from rkhs_ros.base.validation import pick
from rkhs_ros.rkhs.kernels import Array
from rkhs_ros.rollouts.environments import time_limit
from rkhs_ros.runs.config import config_for
from rkhs_ros.studies.aggregates import Estimate, mean_over_runs
from rkhs_ros.studies.workers import run_parallel
from task_learners import LEARNERS, missing
from trial import TASKS, Curves, Key, Point, Task, Trial, median_until, read_curves, write_curves

PAGE = Path(__file__).parents[1] / "docs" / "tasks.md"
CURVES, TABLE = (PAGE.parent / "results" / "tasks" / name for name in ("curves.csv", "table.csv"))
BEGIN, END = "<!-- made by benchmarks/tasks.py -->\n", "<!-- end -->\n"
AFTER = (5, 10, 20, 50, 100)  # episodes
BUDGET = 100  # episodes of learners without a model
TABLES: dict[str, Mapping[str, Any]] = {"tasks": TASKS, "learners": LEARNERS}
QUICK = {"tasks": ["cart-pole"], "learners": ["linear-cma-es"], "seeds": "100"}


def repeat_of(curves: Curves, task: str) -> int | None:
    """Return the median action repeat that ours chose on a task; None if it was not run."""
    chosen = [curve[-1].action_repeat for key, curve in curves.items() if key[:2] == (task, "ours")]
    return int(np.median(chosen)) if chosen else None


def trial_of(task: Task, learner: str, seed: int, repeat: int = 1) -> Trial:
    """Return the trial of a learner, which holds actions for a number of steps if it does not choose that."""
    budget = task.episodes if LEARNERS[learner].has_model else BUDGET
    changes = (*task.changes, *LEARNERS[learner].changes, f"seed={seed}", f"iterations={budget}")  # at most
    config = config_for(task.environment, time_limit(task.environment), changes)
    return Trial(config, budget, task.discounted, repeat, task.success)


def asked(options: Namespace, curves: Curves) -> Iterator[tuple[Key, Trial]]:
    """Yield the missing curves whose packages are installed, and report the others."""
    for task in options.tasks:
        for learner in options.learners:
            chosen, repeat = LEARNERS[learner], repeat_of(curves, task)
            if absent := missing((*TASKS[task].packages, *chosen.packages)):
                print(f"skipped: {task} by {learner}: expected {', '.join(absent)} to be installed", file=sys.stderr)
                continue
            if chosen.holds_actions and (repeat is None or repeat == 1):
                why = "ours to be run first" if repeat is None else "an action repeat other than 1"
                print(f"skipped: {task} by {learner}: expected {why}", file=sys.stderr)
                continue
            for key in (Key(task, learner, seed) for seed in options.seeds):
                if key not in curves:
                    yield key, trial_of(TASKS[task], learner, key.seed, (chosen.holds_actions and repeat) or 1)


@one_thread()
def learnt(key: Key, trial: Trial) -> tuple[Key, list[Point] | str]:
    """Train a learner; return its curve, or the error if it failed."""
    try:
        return key, list(LEARNERS[key.learner].learn(trial))
    except Exception as error:  # a failed run must not end the others
        return key, " ".join(f"{type(error).__name__}: {error}".split())


def run(options: Namespace) -> int:
    """Train the missing curves, and store each, or make the table of all; return the exit code."""
    curves, failed = read_curves(options.curves), False
    if options.table:
        return make_table(cells_of(curves))
    work = list(asked(options, curves))
    for key, result in run_parallel(learnt, work, jobs=options.jobs, title="tasks", quiet=options.quiet):
        if isinstance(result, str):
            failed = True
            print(f"failed: {' '.join(map(str, key))}: {result}", file=sys.stderr)
        else:
            curves[key] = result
            write_curves(options.curves, curves)
    return FAILED if failed else 0


class Cell(NamedTuple):
    """The curves of a learner on a task."""

    task: Task
    curves: Sequence[Sequence[Point]]

    def returns(self, curve: Sequence[Point]) -> Array:
        """Return the returns of a curve that the thresholds are for."""
        return np.array([p.discounted_return if self.task.discounted else p.undiscounted_return for p in curve])

    def first(self, threshold: float) -> list[int | None]:
        """Return the number of the first point of each curve that reaches a threshold."""
        reached = [np.flatnonzero(self.returns(curve) >= threshold) for curve in self.curves]
        return [int(each[0]) if len(each) else None for each in reached]

    def until(self, threshold: float, measure: str) -> Estimate:
        """Return the median ``episodes`` or ``steps`` until a threshold; infinite where it is not reached."""
        counts = [
            np.inf if at is None else float(getattr(curve[at], measure))
            for at, curve in zip(self.first(threshold), self.curves, strict=True)
        ]
        return median_until(np.array(counts))

    def after(self, episodes: int) -> Array:
        """Return the return of each curve at its last point within a number of episodes; nan if it ends earlier."""
        return np.array([self._after(curve, episodes) for curve in self.curves])

    def _after(self, curve: Sequence[Point], episodes: int) -> float:
        within = [number for number, point in enumerate(curve) if point.episodes <= episodes]
        return float(self.returns(curve)[within[-1]]) if within and curve[-1].episodes >= episodes else np.nan

    def below(self, threshold: float) -> str:
        """Return how many of the points after the first success are below the threshold."""
        later = [
            self.returns(curve)[at + 1 :] < threshold
            for at, curve in zip(self.first(threshold), self.curves, strict=True)
            if at is not None
        ]
        count = sum(map(len, later))
        return f"{sum(each.sum() for each in later) / count:.0%}" if count else "-"


def cells_of(curves: Curves) -> dict[str, dict[str, Cell]]:
    """Return the cells by task and learner, in the order of the tables."""
    found: dict[str, dict[str, Cell]] = {}
    for task in TASKS:
        for learner in LEARNERS:
            its = [curve for key, curve in curves.items() if key[:2] == (task, learner)]
            if its:
                found.setdefault(task, {})[learner] = Cell(TASKS[task], its)
    return found


def line_of(task: str, learner: str, cell: Cell) -> tuple[str, ...]:
    """Return the line of a learner on a task in the table."""
    thresholds, rate = cell.task.thresholds, cell.task.rate
    episodes = [cell.until(threshold, "episodes") for threshold in thresholds]
    steps = [cell.until(threshold, "steps") for threshold in thresholds]
    seconds = [Estimate(*(each / rate for each in estimate)) for estimate in steps]
    cost = np.median([curve[-1].cpu_seconds / curve[-1].episodes for curve in cell.curves])
    return (
        task,
        learner,
        str(len(cell.curves)),
        " / ".join(_minus(f"{threshold:g}") for threshold in thresholds),
        *(" / ".join(map(shown, each)) for each in (episodes, steps, seconds)),
        *(shown(mean_over_runs(cell.after(count))) for count in AFTER),
        cell.below(thresholds[0]),
        f"{cost:.2g}",
    )


HEAD = (
    *("task", "learner", "seeds", "thresholds", "episodes to them", "steps to them", "seconds to them"),
    *(f"return after {count}" for count in AFTER),
    *("later below", "CPU s per episode"),
)


def shown(estimate: Estimate) -> str:
    """Return three digits of an estimate and its interval."""
    if np.isnan(estimate.value):
        return "-"
    rounded = [float(f"{each:.3g}") if np.isfinite(each) else each for each in estimate]
    numbers = [
        "never" if np.isinf(each) else _minus(f"{each:,.0f}" if abs(each) >= 1000.0 else f"{each:g}")
        for each in rounded
    ]
    alone = np.isnan(estimate.low) or numbers == ["never"] * 3
    return numbers[0] if alone else f"{numbers[0]} [{numbers[1]}, {numbers[2]}]"


def _minus(text: str) -> str:
    return text.replace("-", "\u2212") if text.startswith("-") else text


def overview(cells: Mapping[str, Mapping[str, Cell]]) -> str:
    """Return a Markdown table of the median episodes until the first threshold, one line per task."""
    learners = [learner for learner in LEARNERS if any(learner in its for its in cells.values())]
    lines = ["| Task | Return | " + " | ".join(f"`{learner}`" for learner in learners) + " |"]
    lines.append("|---" * (2 + len(learners)) + "|")
    for task, its in cells.items():
        threshold = TASKS[task].thresholds[0]
        found = [shown(its[each].until(threshold, "episodes")) if each in its else "-" for each in learners]
        lines.append(f"| `{task}` | {_minus(f'{threshold:g}')} | {' | '.join(found)} |")
    return "\n".join([*lines, ""])


def picture(task: str, cells: Mapping[str, Cell]) -> Figure:
    """Return the returns of the learners over episodes and over seconds of experience: medians and quartiles."""
    figure = Figure((9.0, 2.8), layout="constrained")
    units = {"episodes": 1.0} | (
        {} if np.isnan(TASKS[task].rate) else {"seconds of experience": 1.0 / TASKS[task].rate}
    )
    panels = figure.subplots(1, len(units), sharey=True, squeeze=False)[0]
    for learner, cell in cells.items():
        for panel, unit in zip(panels, units.values(), strict=True):
            counted = "episodes" if unit == 1.0 else "steps"
            at = np.unique([getattr(point, counted) for curve in cell.curves for point in curve])
            steady = [_held(cell, curve, counted, at) for curve in cell.curves]
            low, middle, high = np.nanquantile(steady, (0.25, 0.5, 0.75), axis=0)
            (line,) = panel.plot(at * unit, middle, label=learner, color=COLOURS[learner])
            panel.fill_between(at * unit, low, high, alpha=0.2, color=line.get_color(), linewidth=0)
    for panel, name in zip(panels, units, strict=True):
        panel.set(xscale="log", xlabel=name)
        for threshold in TASKS[task].thresholds:
            panel.axhline(threshold, color="0.7", linewidth=0.8, linestyle=":")
    panels[0].set_ylabel("return" + " (discounted)" * TASKS[task].discounted)
    panels[0].legend(fontsize="small", frameon=False)
    return figure


COLOURS = {learner: f"C{number}" for number, learner in enumerate(LEARNERS)}


def _held(cell: Cell, curve: Sequence[Point], counted: str, at: Array) -> Array:
    """Return the return of the last point before each count; nan before the first point and after the last one."""
    counts = np.array([getattr(point, counted) for point in curve])
    last = np.searchsorted(counts, at, side="right") - 1
    values = cell.returns(curve)[np.maximum(last, 0)]
    return np.where((last >= 0) & (at <= counts[-1]), values, np.nan)


def text_of_table(cells: Mapping[str, Mapping[str, Cell]]) -> str:
    """Return the table as CSV, one line per task and learner."""
    text = StringIO(newline="")
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(HEAD)
    writer.writerows(line_of(task, learner, cell) for task, its in cells.items() for learner, cell in its.items())
    return text.getvalue()


def make_table(cells: Mapping[str, Mapping[str, Cell]]) -> int:
    """Write the table, the overview of the page, and the pictures; return 0."""
    TABLE.write_text(text_of_table(cells))
    PAGE.write_text(page_with(overview(cells)))
    for name, its in cells.items():
        if "ours" in its:
            picture(name, its).savefig(TABLE.parent / f"{name}.png", dpi=100)
    return 0


def page_with(overview: str) -> str:
    """Return the page with an overview in place of its own."""
    before, rest = PAGE.read_text().split(BEGIN)
    return before + BEGIN + "\n" + overview + "\n" + END + rest.split(END)[1]


def options_of(arguments: Sequence[str] | None) -> Namespace:
    """Parse the options.

    Raises:
        ValueError: a name is unknown, or the seeds are no numbers.
    """
    command = parser("How many episodes learners need on a table of tasks.")
    for kind, table in TABLES.items():
        command.add_argument(f"--{kind}", nargs="+", default=list(table), help="default: all, " + ", ".join(table))
    command.add_argument("--seeds", default="0-4", help="such as 0-9 or 0,2,5; default: 0-4")
    command.add_argument("--curves", type=Path, default=CURVES, help="file of the curves; default: that of the page")
    command.add_argument("--table", action="store_true", help="train nothing; make table, page and pictures")
    command.add_argument("--quiet", action="store_true", help="no progress bar")
    add_jobs_argument(command)
    options = parsed(command, arguments, **QUICK)
    for kind, table in TABLES.items():
        for name in getattr(options, kind):
            pick(name, table, kind.removesuffix("s"))
    options.seeds, options.curves = parse_seeds(options.seeds), options.curves.resolve()
    return options


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command; return its exit code."""
    try:
        return run(options_of(arguments))
    except (ValueError, OSError, RunError) as error:
        return print_error(error)
    except KeyboardInterrupt:
        print("interrupted; run the same command to continue", file=sys.stderr)
        return INTERRUPTED


if __name__ == "__main__":
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    from tasks import main as run_main  # by the name under which worker processes import it

    sys.exit(run_main())
