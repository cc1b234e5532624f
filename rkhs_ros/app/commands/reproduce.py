"""``rkhs reproduce``: reproduce the figures of the paper."""

import argparse
from functools import partial
from pathlib import Path

from rkhs_ros.app.study import add_jobs_argument, make_missing, study_folder
from rkhs_ros.base.validation import require
from rkhs_ros.paper.experiment import known, load_experiment
from rkhs_ros.paper.reproduce import draw_experiment, load_table, reproduce


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    out = Path("results/reproduce")
    parser.add_argument("figure", metavar="FIGURE", help=f"{', '.join(known())}, or all")
    parser.add_argument("--runs", type=int, metavar="N", help="independent runs per curve (default: as in the paper)")
    add_jobs_argument(parser)
    parser.add_argument(
        "--out", type=Path, default=out, metavar="DIR", help="folder for the results (default: %(default)s)"
    )
    parser.add_argument("--quiet", action="store_true", help="no progress bar")


def run(options: argparse.Namespace) -> int:
    """Run the experiments, write their table and its picture, and print the paths."""
    require(options.runs is None or options.runs >= 1, "--runs", "at least 1", options.runs)
    out = study_folder(options.out)
    names = list(known()) if options.figure == "all" else [options.figure]
    for experiment in [load_experiment(name) for name in names]:
        make = partial(make_missing, jobs=options.jobs, title=experiment.name, quiet=options.quiet)
        table = reproduce(experiment, out, make, runs=options.runs or experiment.runs)
        picture = table.with_suffix(".png")
        draw_experiment(picture, experiment, load_table(table))
        print(f"{experiment.name}: {table} and {picture}")
    return 0
