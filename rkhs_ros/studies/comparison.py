"""Comparison of runs: returns over the exploration episodes, grouped by settings, with statistics and tables."""

import csv
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from io import StringIO
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from rkhs_ros.base.validation import require
from rkhs_ros.learning.iteration import Row
from rkhs_ros.policies.storage import Task
from rkhs_ros.rkhs.kernels import Array
from rkhs_ros.runs.config import Config, load_config
from rkhs_ros.runs.curve import Curve
from rkhs_ros.runs.report import INITIAL_POLICY
from rkhs_ros.studies.aggregates import Estimate, aggregates, mean_over_runs
from rkhs_ros.studies.grid import OF_THE_COUNT

Line = Mapping[str, Any]  # of a table, by column; all lines have the same columns
CAPTION = (
    "Discounted evaluation returns unless noted otherwise. Brackets show 95 % intervals over the runs by stratified\n"
    "bootstrap. They are too narrow for fewer than five runs. The interquartile mean and the median are those of the\n"
    "final returns. The area under the curve is the mean return over the exploration episodes."
)


class Run(NamedTuple):
    """A run, read from a folder in the place that the user gave, which may be this folder itself."""

    place: Path
    folder: Path
    config: Config
    rows: list[Row]


@dataclass(frozen=True)
class LearningCurve:
    """Learning curves of runs that differ only in their seeds, at the iterations that all of them evaluated.

    Attributes:
        label: name that distinguishes the curve from others.
        episodes: number of exploration episodes up to each iteration, shape (iterations,).
        steps: number of environment steps up to the last of these iterations, mean over the runs.
        returns: discounted returns of evaluation episodes, shape (runs, iterations).
        is_evaluation: False if no iteration was evaluated; the returns are then those of the exploration episodes.
    """

    label: str
    episodes: Array
    steps: float
    returns: Array
    is_evaluation: bool

    def summary(self) -> str:
        """Return the mean final return of the runs in one line."""
        final = mean_over_runs(self.returns[:, -1])
        kind = "evaluation" if self.is_evaluation else "exploration"
        runs = f" (mean of {len(self.returns)} runs, 95 % interval over the seeds)" if len(self.returns) > 1 else ""
        return f"{self.label}: {kind} return {final} after {self.episodes[-1]:g} episodes ({self.steps:g} steps){runs}"


@dataclass(frozen=True)
class Comparison:
    """Learning curves on one task.

    Attributes:
        task: common task of the runs.
        curves: one curve for each group of runs with equal settings.
        limit: number of exploration episodes at which longer runs are cut; None if all are equally long.
        notes: remarks for the reader.
    """

    task: Task
    curves: tuple[LearningCurve, ...]
    limit: int | None
    notes: tuple[str, ...]

    @property
    def table(self) -> list[dict[str, Any]]:
        """The statistics of each curve by name, for `as_csv` and the like."""
        return [
            {
                "curve": c.label,
                "kind": "evaluation" if c.is_evaluation else "exploration",
                "runs": len(c.returns),
                "episodes": float(c.episodes[-1]),
                "steps": c.steps,
            }
            | aggregates(c.episodes, c.returns)
            for c in self.curves
        ]

    def __str__(self) -> str:
        """Return the table in Markdown, followed by the caption and the notes."""
        return "\n".join([as_markdown(self.table), CAPTION, *(f"\n{note}" for note in self.notes), ""])


def compare(folders: str | Path | Iterable[str | Path], labels: Mapping[Path, str] | None = None) -> Comparison:
    """Compare runs as ``rkhs compare`` does, up to the exploration episode at which the shortest run ends.

    Print the comparison for its table.

    Args:
        folders: folders of runs, or folders that contain such folders.
        labels: label of each run's curve, by the run's folder; if None, the curves get distinct names.

    Raises:
        ValueError: a folder contains no run, or the runs cannot be compared.
        OSError: a file cannot be read.
    """
    places = [Path(folders)] if isinstance(folders, str | Path) else [Path(each) for each in folders]
    require(len(places) > 0, "compare", "at least one run's folder", "none")
    runs, empty = _found(places)
    require(len(runs) > 0, f"{(empty or places)[0]}", "a run with at least one iteration", "none")
    notes = [f"Omitted, since it has no finished iteration: {folder}." for folder in empty]
    groups, task = _grouped(runs), _common_task(runs)
    common = max((run.rows[0].episodes for run in runs), key=lambda count: (sum(_spans(r, count) for r in runs), count))
    notes += [f"Omitted, since it does not span episode {common}: {r.folder}." for r in runs if not _spans(r, common)]
    groups = [group for each in groups if (group := [run for run in each if _spans(run, common)])]
    runs = [run for group in groups for run in group]
    shortest = min(runs, key=lambda run: run.rows[-1].episodes)
    limit = shortest.rows[-1].episodes
    cut = any(run.rows[-1].episodes > limit for run in runs)
    if cut:
        notes.append(f"Compared up to exploration episode {limit}, the end of the shortest run: {shortest.folder}.")
    curves = tuple(_curve(*each, limit) for each in zip(_labels(groups, labels), groups, strict=True))
    here = f" up to episode {limit}" if cut else ""
    notes += [f"{c.label}: no evaluation{here}; shows the exploration return." for c in curves if not c.is_evaluation]
    if len({curve.episodes.tobytes() for curve in curves}) > 1:
        notes.append(
            "The areas under the curves are not comparable, since the numbers of episodes at the evaluations differ."
        )
    return Comparison(task, curves, limit if cut else None, tuple(notes))


def _found(places: Sequence[Path]) -> tuple[list[Run], list[Path]]:
    """Return the runs in folders, and the folders of those without a finished iteration."""
    found: dict[Path, Run] = {}
    empty: dict[Path, Path] = {}
    for place in places:
        folders = [place] if _is_run(place) else [path.parent for path in sorted(place.rglob("config.yaml"))]
        expected = "a run's folder (with config.yaml and curve.csv), or a folder of runs"
        require(any(map(_is_run, folders)), f"{place}", expected, "neither")
        for folder in folders:
            if rows := Curve(folder / "curve.csv").rows():
                run = Run(place, folder, load_config(folder / "config.yaml"), rows)
                found.setdefault(folder.resolve(), run)
            else:
                empty.setdefault(folder.resolve(), folder)
    return list(found.values()), list(empty.values())


def _spans(run: Run, episodes: int) -> bool:
    """Return whether the first iteration of a run ends by a number of exploration episodes, and the last not before."""
    return run.rows[0].episodes <= episodes <= run.rows[-1].episodes


def _is_run(folder: Path) -> bool:
    return all((folder / name).is_file() for name in ("config.yaml", "curve.csv"))


def _grouped(runs: list[Run]) -> list[list[Run]]:
    """Return the runs grouped by their settings and initial policies."""
    groups: dict[str, dict[int, Run]] = {}
    for run in runs:
        settings = {name: value for name, value in run.config.settings.items() if name not in OF_THE_COUNT}
        given = run.folder / INITIAL_POLICY
        key = repr((sorted(settings.items()), given.is_file() and given.read_bytes()))
        same = groups.setdefault(key, {}).setdefault(run.config.training.seed, run)
        expected = "settings or a seed that no other run has"
        require(same is run, f"{run.folder}", expected, f"those of {same.folder}")
    return [list(group.values()) for group in groups.values()]


def _common_task(runs: list[Run]) -> Task:
    first = runs[0].config.task
    for run in runs:
        for name in ("environment", "horizon", "discount"):
            expected, got = getattr(first, name), getattr(run.config.task, name)
            require(got == expected, f"{run.folder}: {name}", f"{expected} like {runs[0].folder}", got)
    return first


def _labels(groups: list[list[Run]], given: Mapping[Path, str] | None) -> list[str]:
    """Return a label for each group of runs.

    Without given labels, use the first of these names that differs between all groups: the algorithm, the path given
    by the user, the folder of the run, or its full path.
    """
    if given is not None:
        for group in groups:
            require(group[0].folder in given, "labels", f"a label of {group[0].folder}", sorted(map(str, given)))
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
    within = [[row for row in run.rows if row.episodes <= limit] for run in runs]
    length = min(map(len, within))

    def column(name: str) -> Array:
        return np.array([[getattr(row, name) for row in rows[:length]] for rows in within])

    returns = column("evaluation_return")
    episodes, steps = (column(name).mean(axis=0) for name in ("episodes", "steps"))
    evaluated = ~np.isnan(returns).any(axis=0)
    is_evaluation = bool(evaluated.any())
    if not is_evaluation:
        evaluated, returns = ~evaluated, column("exploration_return")
    return LearningCurve(label, episodes[evaluated], float(steps[evaluated][-1]), returns[:, evaluated], is_evaluation)


def as_csv(lines: Sequence[Line]) -> str:
    """Return a table as CSV with all digits; estimates have separate columns for their bounds, which may be empty."""
    rows, text = [dict(_numbers(line)) for line in lines], StringIO(newline="")
    writer = csv.DictWriter(text, list(rows[0]), lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    return text.getvalue()


def as_markdown(lines: Sequence[Line]) -> str:
    """Return a table as Markdown with aligned columns and rounded numbers."""
    body = [[_text(value).replace("|", "\\|") for value in line.values()] for line in lines]
    head = [name.replace("_", " ") for name in lines[0]]
    widths = [max(map(len, column)) for column in zip(head, *body, strict=True)]
    rows = [head, ["-" * width for width in widths], *body]
    return "".join(f"| {' | '.join(map(str.ljust, row, widths))} |\n" for row in rows)


def _numbers(line: Line) -> Iterator[tuple[str, object]]:
    for name, value in line.items():
        if isinstance(value, Estimate):
            yield name, value.value
            for bound in ("low", "high"):
                number = getattr(value, bound)
                yield f"{name}_{bound}", "" if np.isnan(number) else number
        else:
            yield name, value


def _text(value: object) -> str:
    return f"{value:.5g}" if isinstance(value, float) else str(value)
