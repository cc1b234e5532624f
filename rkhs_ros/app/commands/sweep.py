"""``rkhs sweep``: train at each point of a grid of settings, with several seeds."""

import argparse
import sys
from collections.abc import Mapping, Sequence
from math import isfinite
from pathlib import Path

from rkhs_ros.app.inline import runner_of, warn_of_horizon
from rkhs_ros.app.named import configuration
from rkhs_ros.app.study import (
    add_jobs_argument,
    make_missing,
    parse_seeds,
    report_failures,
    require_all_used,
    study_folder,
)
from rkhs_ros.base.endings import FAILED, INTERRUPTED
from rkhs_ros.base.files import write_whole
from rkhs_ros.base.validation import require
from rkhs_ros.learning.state import first_state
from rkhs_ros.pictures.comparison import draw_comparison
from rkhs_ros.runs.config import load_config
from rkhs_ros.runs.curve import Curve
from rkhs_ros.studies.comparison import compare
from rkhs_ros.studies.grid import (
    Outcome,
    as_csv,
    as_markdown,
    indexed_folder,
    parse_variations,
    points,
    require_evaluated,
)

MOST_DRAWN = 8  # curves that a reader can distinguish
Point = tuple[str, ...]  # changes of the configuration


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    add = parser.add_argument
    add("config", type=configuration, metavar="CONFIG", help="YAML file; see config/")
    add("--vary", nargs="+", action="extend", required=True, metavar="KEY=V,V", help="settings and their values")
    add(
        "--seeds",
        default="0",
        metavar="SEEDS",
        help="seeds of the runs at each point, such as 0-9 or 0,2,5 (default: 0)",
    )
    add("--set", nargs="+", action="extend", default=[], metavar="KEY=VALUE", help="fixed settings to replace")
    about = "returns; the tables contain the number of episodes until each is reached"
    add("--thresholds", nargs="+", type=float, default=[], metavar="R", help=about)
    add_jobs_argument(parser)
    about = "folder for the results (default: results/sweeps/NAME); pass the same folder to continue a sweep"
    add("--out", type=Path, metavar="DIR", help=about)
    add("--quiet", action="store_true", help="no progress bar")


def run(options: argparse.Namespace) -> int:
    """Run what is missing, and write the tables and the picture; return 1 and report the runs that failed, if any."""
    seeds, varied = parse_seeds(options.seeds), parse_variations(options.vary)
    require_all_used(options.set, {"--vary": [each.name for each in varied], "--seeds": ["seed"]})
    require(all(map(isfinite, options.thresholds)), "--thresholds", "finite numbers", options.thresholds)
    configs = {
        (point, seed): load_config(options.config, [*options.set, *point, f"seed={seed}"])
        for point in points(varied)
        for seed in seeds
    }
    first = next(iter(configs.values()))
    with runner_of(first.environment) as runner:
        for (_, seed), config in configs.items():
            if seed == seeds[0]:
                require_evaluated(config)
                first_state(config.training, runner.spaces)
        if not options.quiet:
            warn_of_horizon(runner.simulation, first.training.horizon, given=first.sets_horizon)
    out = study_folder(options.out, "sweeps", first.training.name)
    folders = {key: indexed_folder(out, config) for key, config in configs.items()}
    runs = {folders[key]: config for key, config in configs.items()}
    try:
        failures = make_missing(runs, jobs=options.jobs, title=first.training.name, quiet=options.quiet)
    except KeyboardInterrupt:
        print("interrupted; run the same command to continue", file=sys.stderr)
        return INTERRUPTED
    report_failures(failures)
    done = {key: folder for key, folder in folders.items() if folder not in failures}
    if done:
        _write(out, [each.name for each in varied], done, options.thresholds)
    return FAILED if failures else 0


def _write(out: Path, names: Sequence[str], folders: Mapping[tuple[Point, int], Path], least: Sequence[float]) -> None:
    """Write the tables and the picture, and print the table of medians, best point first."""
    each = {key: Outcome.of(Curve(path / "curve.csv").rows(), least) for key, path in folders.items()}
    lines = [
        ((*_values(point), seed, each_folder.name), each[point, seed]) for (point, seed), each_folder in folders.items()
    ]
    write_whole(out / "runs.csv", as_csv([*names, "seed", "folder"], least, lines).encode())
    grouped: dict[Point, list[Outcome]] = {}
    for (point, _), outcome in each.items():
        grouped.setdefault(point, []).append(outcome)
    medians = {point: Outcome.median(outcomes) for point, outcomes in grouped.items()}
    ranked = sorted(medians, key=lambda point: -medians[point].final)
    rows = [((*_values(point), len(grouped[point])), medians[point]) for point in ranked]
    write_whole(out / "medians.csv", as_csv([*names, "runs"], least, rows).encode())
    table = as_markdown([*names, "runs"], least, rows)
    write_whole(out / "medians.md", table.encode())
    labels = {
        path: ", ".join(_short(names, point)) for (point, _), path in folders.items() if point in ranked[:MOST_DRAWN]
    }
    draw_comparison(out / "comparison.png", compare(list(labels), labels))
    print(table)
    print(f"Medians over the seeds. Tables and picture: {out}/runs.csv, medians.csv, medians.md and comparison.png")


def _values(point: Point) -> list[str]:
    return [change.partition("=")[2] for change in point]


def _short(names: Sequence[str], point: Point) -> list[str]:
    """Return the changes, with the names shortened to their last words if these are unique."""
    last = [name.rpartition(".")[2] for name in names]
    used = last if len(set(last)) == len(last) else names
    return [f"{name}={value}" for name, value in zip(used, _values(point), strict=True)]
