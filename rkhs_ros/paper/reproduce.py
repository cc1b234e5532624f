"""Reproduction of experiments: independent runs, without repeating finished ones, and the table of their returns."""

import csv
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from io import StringIO
from pathlib import Path

import numpy as np

from rkhs_ros.base.endings import RunError
from rkhs_ros.base.files import read_whole, write_whole
from rkhs_ros.learning.iteration import Row
from rkhs_ros.paper.experiment import Experiment
from rkhs_ros.rkhs.kernels import Array
from rkhs_ros.runs.config import Config
from rkhs_ros.runs.curve import Curve
from rkhs_ros.studies.grid import indexed_folder

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


@dataclass(frozen=True)
class Returns:
    """Returns of the runs of a curve.

    Attributes:
        episodes: number of exploration episodes up to each iteration, shape (iterations,).
        exploration: mean discounted return of the exploration episodes, shape (runs, iterations).
        evaluation: mean discounted return of the evaluation episodes after the update, shape (runs, iterations).
    """

    episodes: Array
    exploration: Array
    evaluation: Array

    @property
    def runs(self) -> int:
        """Number of runs."""
        return len(self.exploration)


Table = dict[tuple[str, str], Returns]


def load_table(path: Path) -> Table:
    """Read the returns by panel and curve from a table.

    Raises:
        ValueError: the file does not exist, or is not a table of complete runs.
        OSError: the file cannot be read.
    """
    if not path.exists():
        raise ValueError(f"{path}: expected a table, got none. Run 'rkhs reproduce {path.stem}' to create it")
    content = read_whole(path)
    curves: dict[tuple[str, str], dict[int, list[dict[str, str]]]] = {}
    try:
        for line in csv.DictReader(content.decode().splitlines()):
            curves.setdefault((line["panel"], line["curve"]), {}).setdefault(int(line["run"]), []).append(line)
        return {key: _returns(runs) for key, runs in curves.items()}
    except (KeyError, ValueError) as error:
        raise ValueError(f"{path}: expected the table of an experiment, got an unreadable file ({error})") from error


def _returns(runs: dict[int, list[dict[str, str]]]) -> Returns:
    def column(name: str) -> Array:
        return np.array([[float(line[name]) for line in lines] for lines in runs.values()])

    return Returns(column("episodes")[0], column("exploration_return"), column("evaluation_return"))
