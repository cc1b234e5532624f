"""Measure how many episodes learners need on a table of tasks.

Each finished curve is stored in docs/results/tasks.csv at once. So the same command continues after an interruption,
and trains only the curves that are missing there. The table and the pictures of the page are made from that file.
"""

import os

os.environ["OMP_NUM_THREADS"] = "1"

import csv
import signal
import sys
from argparse import Namespace
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from io import StringIO
from itertools import groupby
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from command import parsed, parser
from rkhs_ros.app.study import add_jobs_argument, parse_seeds
from rkhs_ros.base.endings import FAILED, INTERRUPTED, RunError, print_error
from rkhs_ros.base.files import write_whole
from rkhs_ros.base.processes import one_thread
from rkhs_ros.base.validation import pick
from rkhs_ros.rkhs.kernels import Array
from rkhs_ros.rollouts.environments import time_limit
from rkhs_ros.runs.config import config_for
from rkhs_ros.studies.workers import run_parallel
from task_learners import LEARNERS, missing
from trial import Point, Success, Trial

CURVES = Path(__file__).parents[1] / "docs" / "results" / "tasks.csv"


@dataclass(frozen=True)
class Task:
    """A task of the table.

    Attributes:
        environment: Gymnasium id.
        thresholds: thresholds of the evaluation return.
        rate: steps per second of experience; nan if the task has no time.
        episodes: budget of learners with a model.
        changes: settings that the task needs besides its horizon.
        discounted: whether the thresholds are for the discounted return.
        packages: packages that must be installed.
        success: the task's own criterion, if it has one.
    """

    environment: str
    thresholds: tuple[float, ...]
    rate: float
    episodes: int = 15
    changes: tuple[str, ...] = ()
    discounted: bool = False
    packages: tuple[str, ...] = ()
    success: Success | None = None

    def trial(self, learner: str, seed: int, repeat: int = 1) -> Trial:
        """Return the trial of a learner, which holds actions for a number of steps if it does not choose that."""
        budget = self.episodes if LEARNERS[learner].has_model else BUDGET
        changes = (*self.changes, *LEARNERS[learner].changes, f"seed={seed}", f"iterations={budget}")  # at most
        config = config_for(self.environment, time_limit(self.environment), changes)
        return Trial(config, budget, self.discounted, repeat, self.success)


def balanced(observations: Array) -> Array:
    """Return whether the cart and the pole of each episode are in the middle and upright in the last second."""
    x, cosine, sine = np.moveaxis(observations[:, -20:], 2, 0)[[0, 2, 3]]
    angle = np.pi - np.abs(np.arctan2(sine, cosine))
    return np.asarray(((np.abs(x) <= 0.1) & (angle <= 0.25)).all(axis=1))


BUDGET = 100  # episodes of learners without a model
CLIP, WRAP = (f"environment.options.angle={at_the_ends}" for at_the_ends in ("clip", "wrap"))
ANGLE, WINDOW = "inputs.angles=[0]", "inputs.history=5"
SWUNG_UP = (45.0, 50.0)  # of 51.8 at best
MUJOCO, CONTROL = ("mujoco",), ("shimmy", "dm-control", "mujoco")
THOUSAND = ("horizon=1000",)  # which dm_control does not declare
TASKS = {
    "pendulum-clip": Task("rkhs/Pendulum-v0", SWUNG_UP, 10, changes=(CLIP,), discounted=True),
    "pendulum-wrap": Task("rkhs/Pendulum-v0", SWUNG_UP, 10, changes=(WRAP, ANGLE), discounted=True),
    "pendulum-pomdp": Task("rkhs/PendulumPOMDP-v0", SWUNG_UP, 10, changes=(ANGLE, WINDOW), discounted=True),
    "Pendulum-v1": Task("Pendulum-v1", (-170.0, -150.0), 20),
    "cart-pole": Task("rkhs/CartPoleSwingUp-v0", (45.0, 48.0), 20, success=balanced),
    "cartpole-swingup": Task("shimmy:dm_control/cartpole-swingup-v0", (750.0,), 100, packages=CONTROL),
    "cartpole-balance": Task("shimmy:dm_control/cartpole-balance-v0", (950.0,), 100, 5, packages=CONTROL),
    "pendulum-swingup": Task("shimmy:dm_control/pendulum-swingup-v0", (750.0,), 50, packages=CONTROL),
    "reacher-easy": Task("shimmy:dm_control/reacher-easy-v0", (900.0,), 50, 30, packages=CONTROL),
    "ball-in-cup": Task("shimmy:dm_control/ball_in_cup-catch-v0", (900.0,), 50, 30, packages=CONTROL),
    "InvertedPendulum-v5": Task("InvertedPendulum-v5", (900.0, 999.0), 25, 12, packages=MUJOCO),
    "InvertedDoublePendulum-v5": Task("InvertedDoublePendulum-v5", (9000.0,), 20, 40, packages=MUJOCO),
    "Reacher-v5": Task("Reacher-v5", (-7.0, -6.0), 50, 30, packages=MUJOCO),
    "Swimmer-v5": Task("Swimmer-v5", (30.0, 100.0), 25, packages=MUJOCO),
    "MountainCarContinuous-v0": Task("MountainCarContinuous-v0", (90.0,), float("nan"), 5),
    "ball-on-beam": Task("rkhs/BallOnBeam-v0", (-0.2,), 50),
    "tanks": Task("rkhs/Tanks-v0", (-2.0,), 1),
    "furuta": Task("rkhs/Furuta-v0", (150.0,), 100),
    "pr2-door": Task(
        "rkhs/PR2Door-v0",
        (0.5, 0.8),
        float("nan"),
        100,
        ("environment.options.pose=per_episode",),
        packages=("pybullet",),
    ),
}
TABLES: dict[str, Mapping[str, Any]] = {"tasks": TASKS, "learners": LEARNERS}
QUICK = {"tasks": ["cart-pole"], "learners": ["linear-cma-es"], "seeds": "100"}


class Key(NamedTuple):
    """What a curve is of."""

    task: str
    learner: str
    seed: int


Curves = dict[Key, list[Point]]


def read_curves(path: Path) -> Curves:
    """Return the curves of a file; none if it does not exist."""
    if not path.exists():
        return {}
    with path.open(newline="") as file:
        _, *lines = csv.reader(file)
    return {
        Key(task, learner, int(seed)): [
            Point(int(e), int(s), *map(float, rest), int(repeat)) for _, _, _, e, s, *rest, repeat in each
        ]
        for (task, learner, seed), each in groupby(lines, lambda line: tuple(line[:3]))
    }


def write_curves(path: Path, curves: Curves) -> None:
    """Write a file of curves, sorted by task, learner and seed."""
    text = StringIO(newline="")
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow((*Key._fields, *Point._fields))
    for key in sorted(curves):
        for point in curves[key]:
            writer.writerow((*key, *(f"{value:.6g}" for value in point)))
    write_whole(path, text.getvalue().encode())


def repeat_of(curves: Curves, task: str) -> int | None:
    """Return the median action repeat that ours chose on a task; None if it was not run."""
    chosen = [curve[-1].action_repeat for key, curve in curves.items() if key[:2] == (task, "ours")]
    return int(np.median(chosen)) if chosen else None


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
                    yield key, TASKS[task].trial(learner, key.seed, repeat if chosen.holds_actions and repeat else 1)


@one_thread()
def learnt(key: Key, trial: Trial) -> tuple[Key, list[Point] | str]:
    """Train a learner; return its curve, or the error if it failed."""
    try:
        return key, list(LEARNERS[key.learner].learn(trial))
    except Exception as error:  # a failed run must not end the others
        return key, " ".join(f"{type(error).__name__}: {error}".split())


def run(options: Namespace) -> int:
    """Train the missing curves, and store each; return the exit code."""
    curves, failed = read_curves(options.curves), False
    work = list(asked(options, curves))
    for key, result in run_parallel(learnt, work, jobs=options.jobs, title="tasks", quiet=options.quiet):
        if isinstance(result, str):
            failed = True
            print(f"failed: {' '.join(map(str, key))}: {result}", file=sys.stderr)
        else:
            curves[key] = result
            write_curves(options.curves, curves)
    return FAILED if failed else 0


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
