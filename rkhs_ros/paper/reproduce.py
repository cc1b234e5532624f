"""Experiments made: independent runs side by side, resumed where they stopped, gathered in one table."""

from __future__ import annotations

import csv
from collections.abc import Callable, Iterable, Sequence
from hashlib import blake2b
from io import StringIO
from pathlib import Path

from rkhs_ros.base.files import write_whole
from rkhs_ros.base.yaml_text import dumped
from rkhs_ros.learning.training import Iteration
from rkhs_ros.paper.experiment import Experiment
from rkhs_ros.runs.config import Config
from rkhs_ros.runs.side_by_side import side_by_side
from rkhs_ros.runs.surroundings import surroundings

Make = Callable[[Config], Iterable[Iteration]]
COLUMNS = ("panel", "curve", "run", "iteration", "episodes", "train_return", "mean_policy_return")


def reproduce(
    experiment: Experiment, out: Path, make: Make, *, runs: int, jobs: int, packages: Sequence[str], quiet: bool = False
) -> Path:
    """Make all runs of an experiment and return its table, a csv file.

    A run is filed under its settings and surroundings in ``out/runs``, and not made again where it is there whole.

    Args:
        experiment: what to compare.
        out: folder for the table and the runs.
        make: makes a run; a function of a module, for it is called in other processes.
        runs: number of runs of each curve.
        jobs: number of processes.
        packages: names of those that the tasks are in, so that other code makes other runs.
        quiet: without progress bar.
    """
    (out / "runs").mkdir(parents=True, exist_ok=True)
    code = dumped(surroundings(*packages))
    places = {
        (panel.title, curve.label, run): (config, _file(out, config, code))
        for panel in experiment.panels
        for curve in panel.curves
        for run in range(runs)
        for config in [curve.run(run)]
    }
    missing = {file: config for config, file in places.values() if not _is_whole(file, config)}
    work = [(config, file, make) for file, config in missing.items()]
    for _ in side_by_side(_run, work, jobs=jobs, title=experiment.name, quiet=quiet):
        pass  # each has left its file
    lines = ((*key, *line) for key, (_, file) in places.items() for line in _lines(file))
    return _write(out / f"{experiment.name}.csv", COLUMNS, (map(_short, line) for line in lines))


def _run(config: Config, file: Path, make: Make) -> None:
    lines = [_line(iteration) for iteration in make(config)]
    _write(file, COLUMNS[3:], lines)


def _line(iteration: Iteration) -> tuple[object, ...]:
    returns = float(iteration.train_returns.mean()), float(iteration.mean_policy_returns.mean())
    return (iteration.number, iteration.episodes_used, *returns)


def _file(out: Path, config: Config, code: str) -> Path:
    key = dumped(config.parameters()) + code
    return out / "runs" / f"{blake2b(key.encode(), digest_size=12).hexdigest()}.csv"


def _is_whole(file: Path, config: Config) -> bool:
    """Return whether a run's file is there with a line for each iteration."""
    try:
        numbers = [line[0] for line in _lines(file)]
    except (OSError, ValueError):
        return False
    return numbers == list(range(1, config.training.iterations + 1))


def _lines(file: Path) -> Iterable[tuple[object, ...]]:
    kinds: tuple[Callable[[str], object], ...] = (int, int, float, float)
    with file.open(newline="") as text:
        for line in list(csv.reader(text))[1:]:
            yield tuple(kind(word) for kind, word in zip(kinds, line, strict=True))


def _write(file: Path, header: Iterable[str], lines: Iterable[Iterable[object]]) -> Path:
    """Write a table whole or not at all."""
    text = StringIO(newline="")
    csv.writer(text, lineterminator="\n").writerows([header, *lines])
    write_whole(file, text.getvalue().encode())
    return file


def _short(value: object) -> object:
    return f"{value:.3f}" if isinstance(value, float) else value
