"""Table of an experiment: the returns of the runs of each curve."""

import csv
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from rkhs_ros.base.files import read_whole
from rkhs_ros.rkhs.kernels import Array


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
