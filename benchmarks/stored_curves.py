"""Run a program that trains learning curves, stores each in a file and writes a table of them.

Each curve's file is named by a hash of everything that the curve depends on. So the same command continues after an
interruption, and repeats only the curves affected by changed settings or code.
"""

from __future__ import annotations

import signal
import sys
from argparse import ArgumentParser, Namespace
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, NoReturn

from rkhs_ros.app.seeds import parse_seeds
from rkhs_ros.app.study import add_worker_arguments, workers_of
from rkhs_ros.base.endings import FAILED, INTERRUPTED, RunError, print_error
from rkhs_ros.base.files import write_whole
from rkhs_ros.base.threads import one_thread
from rkhs_ros.base.validation import pick
from rkhs_ros.studies.parallel import run_parallel
from trial import Point, write_curve

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
    add_worker_arguments(command)
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
    options.workers = workers_of(options)
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
    for path, why in run_parallel(learn, work, workers=options.workers, title=title, quiet=options.quiet):
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
