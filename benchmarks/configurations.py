"""Measure the returns of the configurations in ``config/`` on held-out seeds, and the episodes to thresholds.

CMA-ES is measured beside them. No setting was chosen on the seeds from 100 on, which the documentation uses. Episodes
count until the evaluation return, the mean of 10 evaluation episodes after an update, first passes a threshold.
"""

from __future__ import annotations

import os
from argparse import Namespace
from pathlib import Path

os.environ["OMP_NUM_THREADS"] = "1"

from command import parsed, parser
from reached import Result, as_csv, as_markdown, measure, names, read_results
from rkhs_ros.app.seeds import parse_seeds
from rkhs_ros.app.study import add_worker_arguments, workers_of
from rkhs_ros.base.files import write_whole
from rkhs_ros.studies.parallel import run_parallel

FEW, MANY = "100-109", "100-119"
WITH_MANY = {f"{task}_{kind}_nac" for task in ("pendulum", "pendulum_wrap", "toy") for kind in ("few", "model")}
QUICK = ["toy_few_nac", "toy_few_nac by CMA-ES, sd 0.25", "pendulum_enac"]
QUICK_CHANGES = ("iterations=2", "horizon=5")


def seeds_of(name: str) -> str:
    """Return the seeds of the figures in the documentation."""
    return MANY if name in WITH_MANY else FEW


def learnt(options: Namespace) -> list[Result]:
    """Train, and return the results in the order of the names."""
    changes = QUICK_CHANGES if options.quick else ()
    work = [
        (name, seed, changes)
        for name in options.names or names()
        for seed in parse_seeds(options.seeds or seeds_of(name))
    ]
    return list(run_parallel(measure, work, workers=workers_of(options), title="runs", quiet=options.quick))


def main(options: Namespace) -> None:
    """Train what is requested, store the results, and print the tables."""
    stored = read_results(options.out) if options.out and options.out.exists() else []
    results = {(each.name, each.seed): each for each in [*stored, *([] if options.tables else learnt(options))]}
    if options.out and not options.tables:
        write_whole(options.out, as_csv(results.values()).encode())
    print(as_markdown(sorted(results.values())), end="")


if __name__ == "__main__":
    command = parser(__doc__)
    command.add_argument("names", nargs="*", metavar="NAME", help="configurations (all)")
    command.add_argument("--seeds", help="such as 100-119 or 100,105 (those of the documentation)")
    command.add_argument("--out", type=Path, metavar="FILE.csv", help="add the results to this file")
    command.add_argument("--tables", action="store_true", help="only print the tables of the file")
    add_worker_arguments(command)
    main(parsed(command, names=QUICK, seeds="100-101"))
