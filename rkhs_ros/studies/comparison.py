"""Runs compared: for each way to learn the returns of its runs over the exploring episodes, and what they come to."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np

from rkhs_ros.base.validation import require
from rkhs_ros.policies.storage import Task
from rkhs_ros.rkhs.kernels import Array
from rkhs_ros.runs.config import Config, load_config
from rkhs_ros.runs.curve import Curve, Row
from rkhs_ros.studies.aggregates import Aggregates, aggregates, mean_over_runs

NOT_COMPARED = ("seed", "name", "simulators", "timeout")  # settings that make no other way to learn


class Run(NamedTuple):
    """A run read from its folder, which was found in the place."""

    place: Path
    folder: Path
    config: Config
    rows: list[Row]


@dataclass(frozen=True)
class LearningCurve:
    """The runs of one way to learn, at the iterations that all of them evaluated.

    Attributes:
        label: what tells it from the others.
        episodes: exploring episodes used up to each iteration, shape (iterations,).
        returns: discounted returns of evaluation episodes, shape (runs, iterations).
        is_evaluation: False where no iteration was evaluated: the returns are those of the exploring episodes.
    """

    label: str
    episodes: Array
    returns: Array
    is_evaluation: bool

    def aggregates(self) -> Aggregates:
        """Return what the runs come to."""
        return aggregates(self.episodes, self.returns)

    def summary(self) -> str:
        """Return in one line what the runs come to at their end."""
        final = mean_over_runs(self.returns[:, -1])
        kind = "noise-free" if self.is_evaluation else "exploring"
        over = f" (mean of {len(self.returns)} runs, 95 % interval over the seeds)" if len(self.returns) > 1 else ""
        return f"{self.label}: {kind} return {final} after {self.episodes[-1]:g} episodes{over}"


@dataclass(frozen=True)
class Comparison:
    """Learning curves on one task.

    Attributes:
        task: what is learnt.
        curves: one for each way to learn.
        notes: what is to be said of them.
    """

    task: Task
    curves: tuple[LearningCurve, ...]
    notes: tuple[str, ...]


def compare(places: Sequence[Path], labels: Mapping[Path, str] | None = None) -> Comparison:
    """Compare runs, up to the number of exploring episodes at which the shortest one ends.

    Args:
        places: folders of runs, or folders that hold such.
        labels: of the ways to learn, by the folders of their runs; where None, names that tell them apart.

    Raises:
        ValueError: a place holds no run, or the runs are not to be compared.
        OSError: a file cannot be read.
    """
    runs, notes = _with_rows(_found(places))
    groups = _grouped(runs)
    task = _common_task(runs)
    shortest = min(runs, key=lambda run: run.rows[-1].episodes)
    limit = shortest.rows[-1].episodes
    if any(run.rows[-1].episodes > limit for run in runs):
        notes.append(f"Compared up to {limit} exploring episodes, where the shortest run ends: {shortest.folder}.")
    curves = tuple(_curve(*each, limit) for each in zip(_labels(groups, labels), groups, strict=True))
    notes += [f"{c.label}: never evaluated, so its exploring return is taken." for c in curves if not c.is_evaluation]
    if len({curve.episodes.tobytes() for curve in curves}) > 1:
        notes.append(
            "Evaluated after different numbers of episodes: the areas under the curves are not to be compared."
        )
    return Comparison(task, curves, tuple(notes))


def _found(places: Sequence[Path]) -> list[Run]:
    found: dict[Path, Run] = {}
    for place in places:
        folders = [place] if _is_run(place) else [path.parent for path in sorted(place.rglob("config.yaml"))]
        folders = [folder for folder in folders if _is_run(folder)]
        expected = "the folder of a run, or one that holds such folders (with config.yaml and curve.csv)"
        require(len(folders) > 0, f"{place}", expected, "neither")
        for folder in folders:
            run = Run(place, folder, load_config(folder / "config.yaml"), Curve(folder / "curve.csv").rows())
            found.setdefault(folder.resolve(), run)
    return list(found.values())


def _is_run(folder: Path) -> bool:
    return all((folder / name).is_file() for name in ("config.yaml", "curve.csv"))


def _with_rows(runs: list[Run]) -> tuple[list[Run], list[str]]:
    """Return the runs that have made an iteration, and a note on each of the others."""
    begun = [run for run in runs if run.rows]
    require(len(begun) > 0, f"{runs[0].folder}", "a run that has made an iteration", "none")
    return begun, [f"Left out, for it has not made an iteration: {run.folder}." for run in runs if not run.rows]


def _grouped(runs: list[Run]) -> list[list[Run]]:
    """Return the runs of each way to learn.

    Raises:
        ValueError: two of them have the same seed, so that one says nothing beyond the other.
    """
    groups: dict[str, dict[int, Run]] = {}
    for run in runs:
        settings = {name: value for name, value in run.config.settings.items() if name not in NOT_COMPARED}
        group, seed = groups.setdefault(repr(sorted(settings.items())), {}), run.config.training.seed
        require(seed not in group, f"{run.folder}", "settings or a seed of its own", f"those of {_folder(group, seed)}")
        group[seed] = run
    return [list(group.values()) for group in groups.values()]


def _folder(group: dict[int, Run], seed: int) -> str:
    return str(group[seed].folder) if seed in group else ""


def _common_task(runs: list[Run]) -> Task:
    """Return the task of all runs.

    Raises:
        ValueError: their returns are not those of one task.
    """
    first = runs[0].config.task
    for run in runs:
        for name in ("environment", "horizon", "discount"):
            expected, got = getattr(first, name), getattr(run.config.task, name)
            require(got == expected, f"{run.folder}: {name}", f"{expected}, as of {runs[0].folder}", got)
    return first


def _labels(groups: list[list[Run]], given: Mapping[Path, str] | None) -> list[str]:
    """Return for each group the label given, or the first of these names that tells all apart."""
    if given is not None:
        return [given[group[0].folder] for group in groups]
    names: tuple[Callable[[Run], str], ...] = (
        lambda run: str(run.config.settings["algorithm.name"]),
        lambda run: run.place.resolve().name,
        lambda run: run.folder.resolve().name,
        lambda run: str(run.folder.resolve()),
    )
    labels = ([name(group[0]) for group in groups] for name in names)
    return next(each for each in labels if len(set(each)) == len(groups))


def _curve(label: str, runs: list[Run], limit: int) -> LearningCurve:
    kept = [[row for row in run.rows if row.episodes <= limit] for run in runs]
    for run, rows in zip(runs, kept, strict=True):
        require(len(rows) > 0, f"{run.folder}", f"an iteration within {limit} exploring episodes", "none")
    length = min(map(len, kept))

    def column(name: str) -> Array:
        return np.array([[getattr(row, name) for row in rows[:length]] for rows in kept])

    num_evaluation, episodes = column("evaluation_return"), column("episodes").mean(axis=0)
    evaluated = ~np.isnan(num_evaluation).any(axis=0)
    if not evaluated.any():
        return LearningCurve(label, episodes, column("exploration_return"), is_evaluation=False)
    return LearningCurve(label, episodes[evaluated], num_evaluation[:, evaluated], is_evaluation=True)
