"""Run learners on tasks, and store each learning curve against the episodes used.

Each curve's file is named by a hash of everything that the curve depends on. So the same command continues after an
interruption, and repeats only the curves affected by changed settings or code.
"""

import csv
import signal
import sys
import time
from argparse import ArgumentParser, Namespace
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from io import StringIO
from pathlib import Path
from typing import Any, NamedTuple, NoReturn

import numpy as np

from rkhs_ros.app.inline import runner_of
from rkhs_ros.app.study import add_jobs_argument, parse_seeds
from rkhs_ros.base.endings import FAILED, INTERRUPTED, RunError, print_error
from rkhs_ros.base.files import write_whole
from rkhs_ros.base.processes import one_thread
from rkhs_ros.base.validation import pick
from rkhs_ros.learning.episodes import Episodes
from rkhs_ros.policies.gaussian import GaussianPolicy
from rkhs_ros.policies.streams import Batch
from rkhs_ros.rkhs.kernels import Array
from rkhs_ros.runs.config import Config
from rkhs_ros.studies.aggregates import Estimate, median_over_runs
from rkhs_ros.studies.workers import run_parallel


@dataclass(frozen=True)
class Trial:
    """The input of a learner.

    Attributes:
        config: task, seed, and the settings of learners that use them.
        episodes: budget; the learner stops after the first update that reaches it.
        discounted: whether the thresholds of the task are for the discounted return.
    """

    config: Config
    episodes: int
    discounted: bool

    @property
    def judged_by(self) -> float:
        """Discount of the return that the thresholds are for."""
        return self.config.training.discount if self.discounted else 1.0


class Point(NamedTuple):
    """One point of a learning curve, after an update.

    Attributes:
        episodes: real exploration episodes so far.
        steps: steps of these episodes.
        cpu_seconds: CPU time of training and exploration so far, over all threads, without evaluations.
        undiscounted_return: mean over the evaluation episodes.
        discounted_return: the same with the task's discount.
    """

    episodes: int
    steps: int
    cpu_seconds: float
    undiscounted_return: float
    discounted_return: float


class Meter:
    """Counts episodes, steps and CPU time of a learner. Owns the counts.

    Args:
        discount: discount of the returns.
    """

    def __init__(self, discount: float) -> None:
        self.episodes = 0
        self.steps = 0
        self._discount = discount
        self._begin = time.process_time()

    @contextmanager
    def paused(self) -> Iterator[None]:
        """Exclude the CPU time of the block."""
        at = time.process_time()
        yield
        self._begin += time.process_time() - at

    def point(self, rewards: Array) -> Point:
        """Return the point of the curve for evaluation rewards of shape (episodes, horizon)."""
        seconds = time.process_time() - self._begin
        undiscounted, discounted = (
            float((rewards @ discount ** np.arange(rewards.shape[1])).mean()) for discount in (1.0, self._discount)
        )
        return Point(self.episodes, self.steps, seconds, undiscounted, discounted)


class MeteredRunner:
    """Rolls out policies in the task of a configuration, and counts exploration episodes but not evaluation episodes.

    Args:
        config: configuration of the task.
        meter: counts the episodes.
    """

    def __init__(self, config: Config, meter: Meter) -> None:
        self._runner = runner_of(config.environment)
        self._meter = meter
        self.spaces = self._runner.spaces

    def capacity(self, num_envs: int) -> int:
        """Return 1: no episodes run in advance, so that exploration and evaluation are counted separately."""
        return 1

    def collect(self, policy: GaussianPolicy, batch: Batch) -> Episodes:
        """Return the episodes of a batch under the policy."""
        if not batch.explore:
            with self._meter.paused():
                return self._runner.collect(policy, batch)
        episodes = self._runner.collect(policy, batch)
        self._meter.episodes += len(episodes)
        self._meter.steps += int(episodes.mask.sum())
        return episodes


def write_curve(path: Path, points: Iterable[Point]) -> None:
    """Write a learning curve atomically."""
    text = StringIO(newline="")
    writer = csv.writer(text, lineterminator="\n")
    writer.writerows([Point._fields, *points])
    write_whole(path, text.getvalue().encode())


def read_curve(path: Path) -> list[Point]:
    """Return the points of a learning curve."""
    with path.open(newline="") as file:
        _, *lines = csv.reader(file)
    return [Point(int(e), int(s), *map(float, rest)) for e, s, *rest in lines]


Outcome = tuple[Path, str | None]  # file of a curve, and the error if its run failed


def add_arguments(command: ArgumentParser, name: str, seeds: str, **tables: Mapping[str, Any]) -> None:
    """Declare the arguments of a program.

    Args:
        command: its parser.
        name: name of the program, and of its folder in results/.
        seeds: default of ``--seeds``.
        **tables: for each option that selects names, the table of the known ones.
    """
    for kind, table in tables.items():
        command.add_argument(f"--{kind}", nargs="+", default=list(table), help="default: all, " + ", ".join(table))
    command.add_argument("--seeds", default=seeds, help=f"such as 0-9 or 0,2,5; default: {seeds}")
    add_jobs_argument(command)
    folder = Path("results") / name
    command.add_argument("--out", type=Path, default=folder, help=f"folder; default: {folder}")
    command.add_argument("--quiet", action="store_true", help="no progress bar")


def check_options(options: Namespace, **tables: Mapping[str, Any]) -> None:
    """Replace the texts of the options of `add_arguments` by their values.

    Raises:
        ValueError: a name is unknown, or a number does not fit.
    """
    for kind, table in tables.items():
        names = list(dict.fromkeys(getattr(options, kind)))
        for name in names:
            pick(name, table, kind.removesuffix("s"))
        setattr(options, kind, names)
    options.seeds = parse_seeds(options.seeds)
    options.out = options.out.resolve()  # runs may be in another folder


@one_thread()
def store_curve(path: Path, points: Callable[[], Iterable[Point]]) -> Outcome:
    """Train and write the curve; return its file, and the error if it fails."""
    try:
        write_curve(path, points())
    except Exception as error:  # a failed run must not end the others
        return path, " ".join(f"{type(error).__name__}: {error}".split())
    return path, None


def train_missing(
    learn: Callable[..., Outcome], work: Sequence[tuple[Any, ...]], options: Namespace, title: str
) -> int:
    """Train curves in parallel and report the runs that fail; return the exit code.

    Args:
        learn: function that trains one curve and stores it.
        work: its arguments for each missing curve.
        options: the options of `check_options`.
        title: title of the progress bar.
    """
    failed = False
    for path, why in run_parallel(learn, work, jobs=options.jobs, title=title, quiet=options.quiet):
        if why is not None:
            failed = True
            print(f"failed: {path.stem}: {why}", file=sys.stderr)
    return FAILED if failed else 0


def write_table(out: Path, as_csv: str, as_markdown: str) -> None:
    """Write summary.csv and table.md, and print the table."""
    write_whole(out / "summary.csv", as_csv.encode())
    write_whole(out / "table.md", as_markdown.encode())
    print(as_markdown, end="")


def exit_code(run: Callable[[], int]) -> int:
    """Run a program; return its exit code, after one line for an error or an interruption."""
    try:
        return run()
    except (ValueError, OSError, RunError) as error:
        return print_error(error)
    except KeyboardInterrupt:
        print("interrupted; run the same command to continue", file=sys.stderr)
        return INTERRUPTED


def exit_with(main: Callable[[], int]) -> NoReturn:
    """Run the main function of a script, which SIGTERM interrupts like Ctrl-C, and exit with its code."""
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    sys.exit(main())


NEVER = 1e15  # episodes or steps, instead of infinity, so that means and differences are defined


def median_until(values: Array) -> Estimate:
    """Return the median over the runs of counts, some of which may be infinite."""
    estimate = median_over_runs(np.minimum(values, NEVER))
    return Estimate(*(np.inf if number > NEVER / 1e5 else float(number) for number in estimate))
