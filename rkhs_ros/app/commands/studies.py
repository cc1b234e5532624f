"""``rkhs compare``, ``rkhs sweep`` and ``rkhs reproduce``: compare runs, and run and compare many."""

import argparse
import sys
from collections.abc import Mapping, Sequence
from functools import partial
from math import isfinite
from pathlib import Path

from rkhs_ros.app.inline import add_settings_argument, runner_of, warn_of_horizon
from rkhs_ros.app.study import add_jobs_argument, make_missing, parse_seeds, report_failures
from rkhs_ros.base.endings import FAILED, INTERRUPTED
from rkhs_ros.base.files import write_whole
from rkhs_ros.base.validation import require
from rkhs_ros.learning.state import first_state
from rkhs_ros.paper.experiment import known, load_experiment
from rkhs_ros.paper.reproduce import draw_experiment, reproduce
from rkhs_ros.pictures.run_pictures import draw_comparison, format_of
from rkhs_ros.runs.config import load_config
from rkhs_ros.runs.curve import Curve
from rkhs_ros.studies import grid
from rkhs_ros.studies.comparison import as_csv, as_markdown, compare

MOST_DRAWN = 8  # curves that a reader can distinguish
Point = tuple[str, ...]  # changes of the configuration


def add_compare(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of ``rkhs compare``."""
    add, out = parser.add_argument, Path("comparison.png")
    add("folders", type=Path, nargs="+", metavar="DIR", help="a run's folder, or a folder of runs")
    about = "picture; the tables are written beside it as .csv and .md (default: %(default)s)"
    add("--out", type=Path, default=out, metavar="FILE.png", help=about)


def run_compare(options: argparse.Namespace) -> int:
    """Draw the picture, write the tables beside it, and print the table."""
    format_of(options.out)  # raises before anything is written
    comparison = compare(options.folders)
    options.out.parent.mkdir(parents=True, exist_ok=True)
    draw_comparison(options.out, comparison)
    files = {options.out.with_suffix(".csv"): as_csv(comparison.table), options.out.with_suffix(".md"): str(comparison)}
    for path, content in files.items():
        write_whole(path, content.encode())
    print(comparison)
    print(f"Picture and tables: {', '.join(map(str, [options.out, *files]))}")
    return 0


def add_sweep(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of ``rkhs sweep``."""
    add = parser.add_argument
    add("config", type=Path, metavar="CONFIG", help="YAML file; see config/")
    add("--vary", nargs="+", action="extend", required=True, metavar="KEY=V,V", help="settings and their values")
    about = "seeds of the runs at each point, such as 0-9 or 0,2,5 (default: 0)"
    add("--seeds", default="0", metavar="SEEDS", help=about)
    add_settings_argument(parser, "iterations=20")
    about = "returns; the tables contain the number of episodes until each is reached"
    add("--thresholds", nargs="+", type=float, default=[], metavar="R", help=about)
    add_jobs_argument(parser)
    about = "folder for the results (default: results/sweeps/NAME); pass the same folder to continue a sweep"
    add("--out", type=Path, metavar="DIR", help=about)
    add("--quiet", action="store_true", help="no progress bar")


def run_sweep(options: argparse.Namespace) -> int:
    """Run what is missing, and write the tables and the picture; return 1 and report the runs that failed, if any."""
    seeds, varied = parse_seeds(options.seeds), grid.parse_variations(options.vary)
    require(all(map(isfinite, options.thresholds)), "--thresholds", "finite numbers", options.thresholds)
    configs = {
        (point, seed): load_config(options.config, [*options.set, *point, f"seed={seed}"])
        for point in grid.points(varied)
        for seed in seeds
    }
    first = next(iter(configs.values()))
    with runner_of(first.environment) as runner:
        for (_, seed), config in configs.items():
            if seed == seeds[0]:
                grid.require_evaluated(config)
                first_state(config.training, runner.spaces)
        if not options.quiet:
            warn_of_horizon(runner.simulation, first.training.horizon)
    name = first.training.name
    out = (options.out or Path("results", "sweeps", name)).resolve()
    in_use = out.is_dir() and any(out.iterdir()) and not (out / "runs").is_dir()
    require(not in_use, f"{out}", "a new or empty folder, or that of a sweep", "one in use")
    folders = {key: grid.indexed_folder(out, config) for key, config in configs.items()}
    runs = {folders[key]: config for key, config in configs.items()}
    try:
        failures = make_missing(runs, jobs=options.jobs, title=name, quiet=options.quiet)
    except KeyboardInterrupt:
        print("interrupted; run the same command to continue", file=sys.stderr)
        return INTERRUPTED
    report_failures(failures)
    done = {key: folder for key, folder in folders.items() if folder not in failures}
    if done:
        _write(out, list(varied), done, options.thresholds)
    return FAILED if failures else 0


def _write(out: Path, names: Sequence[str], folders: Mapping[tuple[Point, int], Path], least: Sequence[float]) -> None:
    each = {key: grid.outcome(Curve(path / "curve.csv").rows(), least) for key, path in folders.items()}
    lines = [
        {**_settings(names, point), "seed": seed, "folder": folder.name, **each[point, seed]}
        for (point, seed), folder in folders.items()
    ]
    write_whole(out / "runs.csv", as_csv(lines).encode())
    grouped: dict[Point, list[Mapping[str, float]]] = {}
    for (point, _), outcome in each.items():
        grouped.setdefault(point, []).append(outcome)
    medians = {point: grid.medians(outcomes) for point, outcomes in grouped.items()}
    ranked = sorted(medians, key=lambda point: -medians[point]["final_return"])
    rows = [{**_settings(names, point), "runs": len(grouped[point]), **medians[point]} for point in ranked]
    write_whole(out / "medians.csv", as_csv(rows).encode())
    table = as_markdown(rows)
    write_whole(out / "medians.md", table.encode())
    last = [name.rpartition(".")[2] for name in names]
    short = last if len(set(last)) == len(last) else names
    drawn = ((point, path) for (point, _), path in folders.items() if point in ranked[:MOST_DRAWN])
    labels = {path: ", ".join(map("{}={}".format, short, _settings(names, point).values())) for point, path in drawn}
    print(table)
    comparison = compare(list(labels), labels)
    draw_comparison(out / "comparison.png", comparison)
    for note in comparison.notes:
        print(note)
    print(f"Medians over the seeds. Tables and picture: {out}/runs.csv, medians.csv, medians.md and comparison.png")


def _settings(names: Sequence[str], point: Point) -> dict[str, str]:
    return {name: change.partition("=")[2] for name, change in zip(names, point, strict=True)}


def add_reproduce(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of ``rkhs reproduce``."""
    add, out = parser.add_argument, Path("results/reproduce")
    add("figure", metavar="FIGURE", help=f"{', '.join(known())}, or all")
    add("--runs", type=int, metavar="N", help="independent runs per curve (default: as in the paper)")
    add_jobs_argument(parser)
    add("--out", type=Path, default=out, metavar="DIR", help="folder for the results (default: %(default)s)")
    add("--quiet", action="store_true", help="no progress bar")


def run_reproduce(options: argparse.Namespace) -> int:
    """Run the experiments, write their table and its picture, and print the paths."""
    require(options.runs is None or options.runs >= 1, "--runs", "at least 1", options.runs)
    names = list(known()) if options.figure == "all" else [options.figure]
    for experiment in [load_experiment(name) for name in names]:
        make = partial(make_missing, jobs=options.jobs, title=experiment.name, quiet=options.quiet)
        picture = options.out.resolve() / f"{experiment.name}.png"
        table = reproduce(experiment, picture.parent, make, runs=options.runs or experiment.runs)
        draw_experiment(picture, experiment, table)
        print(f"{experiment.name}: {picture.with_suffix('.csv')} and {picture}")
    return 0
