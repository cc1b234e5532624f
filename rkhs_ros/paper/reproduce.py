"""Reproduction of experiments: independent runs, without repeating finished ones, collected in one table."""

import csv
from collections.abc import Callable, Mapping
from io import StringIO
from pathlib import Path

from rkhs_ros.base.endings import RunError
from rkhs_ros.base.files import write_whole
from rkhs_ros.paper.experiment import Experiment
from rkhs_ros.runs.config import Config
from rkhs_ros.runs.curve import Curve, Row
from rkhs_ros.studies.run_index import indexed_folder

Make = Callable[[Mapping[Path, Config]], Mapping[Path, str]]
COLUMNS = ("panel", "curve", "run", "iteration", "episodes", "exploration_return", "evaluation_return")


def reproduce(experiment: Experiment, out: Path, make: Make, *, runs: int) -> Path:
    """Run an experiment and return its table, a CSV file.

    Args:
        experiment: the experiment.
        out: folder for the table and the runs, which are indexed by settings and provenance.
        make: function that starts or resumes runs in their folders, and returns the errors of failed runs by folder.
        runs: number of runs of each curve.

    Raises:
        RunError: a run failed.
    """
    places = {
        (panel.title, curve.label, run): curve.run(run)
        for panel in experiment.panels
        for curve in panel.curves
        for run in range(runs)
    }
    folders = {key: indexed_folder(out, config) for key, config in places.items()}
    failures = make({folders[key]: config for key, config in places.items()})
    for folder, why in failures.items():
        raise RunError(
            f"{folder}: {why} ({len(failures)} of {len(folders)} runs failed; run the same command to continue)"
        )
    text = StringIO(newline="")
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(COLUMNS)
    writer.writerows((*key, *_line(row)) for key, path in folders.items() for row in Curve(path / "curve.csv").rows())
    table = out / f"{experiment.name}.csv"
    write_whole(table, text.getvalue().encode())
    return table


def _line(row: Row) -> tuple[object, ...]:
    return row.iteration, row.episodes, f"{row.exploration_return:.3f}", f"{row.evaluation_return:.3f}"
