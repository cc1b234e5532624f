"""``rkhs reproduce``: make the paper's figures again."""

from __future__ import annotations

import argparse
from pathlib import Path

from rkhs_ros.app.inline import iterations
from rkhs_ros.base.validation import require
from rkhs_ros.paper.experiment import known, load_experiment
from rkhs_ros.paper.figures import draw_experiment
from rkhs_ros.paper.reproduce import reproduce
from rkhs_ros.paper.table import load_table
from rkhs_ros.runs.side_by_side import check_jobs

TASKS = ("sim_nodes",)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    out = Path("results/reproduce")
    parser.add_argument("figure", metavar="FIGURE", help=f"{', '.join(known())}, or all")
    parser.add_argument("--runs", type=int, metavar="N", help="independent runs of each curve (the paper's number)")
    parser.add_argument("--jobs", type=int, default=-1, metavar="J", help="processes side by side (all cores)")
    parser.add_argument("--out", type=Path, default=out, metavar="DIR", help="where the results go (%(default)s)")
    parser.add_argument("--quiet", action="store_true", help="no progress bar")


def run(options: argparse.Namespace) -> int:
    """Make the runs, their table and its picture, and print where they are."""
    require(options.runs is None or options.runs >= 1, "--runs", "at least 1", options.runs)
    check_jobs(options.jobs)
    names = list(known()) if options.figure == "all" else [options.figure]
    for experiment in [load_experiment(name) for name in names]:
        work = {"runs": options.runs or experiment.runs, "jobs": options.jobs, "packages": TASKS}
        table = reproduce(experiment, options.out, iterations, **work, quiet=options.quiet)
        picture = table.with_suffix(".png")
        draw_experiment(picture, experiment, load_table(table))
        print(f"{experiment.name}: {table} and {picture}")
    return 0
