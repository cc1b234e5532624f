"""Reproduction of experiments: runs, without repeating finished ones, the table of their returns, and the figure.

Each panel of a figure is plotted over iterations and over episodes, as in the paper.
"""

import csv
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from io import StringIO
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from rkhs_ros.base.endings import RunError
from rkhs_ros.base.files import read_whole, write_whole
from rkhs_ros.learning.iteration import Row
from rkhs_ros.paper.experiment import Experiment, Panel
from rkhs_ros.pictures.known import references
from rkhs_ros.pictures.style import draw_references, label, legend_above, looks, sheet, write
from rkhs_ros.rkhs.kernels import Array
from rkhs_ros.runs.config import Config
from rkhs_ros.runs.curve import Curve
from rkhs_ros.studies.grid import indexed_folder

Make = Callable[[Mapping[Path, Config]], Mapping[Path, str]]
CONFIDENCE = 1.96  # standard errors on both sides of 95 %
WIDTH_IN, HEIGHT_IN = 6.0, 7.6  # of a panel's two plots
DPI = 90
PREFIX = re.compile(r"^(RKHS-|e(?=[A-Z]))")  # of a method's name: its space of policies
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


def draw_experiment(path: Path, experiment: Experiment, table: Table) -> None:
    """Draw the mean evaluation returns over the runs, with the band of the experiment.

    Raises:
        OSError: the file cannot be written.
    """
    write(path, experiment_figure(experiment, table), dpi=DPI)


def experiment_figure(experiment: Experiment, table: Table) -> Figure:
    """Return the figure of an experiment."""
    runs = max(returns.runs for returns in table.values())
    band = "95 % confidence of the mean" if experiment.band == "confidence" else "one standard deviation of the runs"
    subtitle = f"evaluation return, mean of {runs} runs; band: {band}, within the range of the runs"
    columns = len(experiment.panels)
    figure = sheet(WIDTH_IN * columns, HEIGHT_IN, f"{experiment.title}\n{subtitle}")
    plots = figure.subplots(2, columns, sharey="col", squeeze=False)
    shown = styles_of(experiment)
    for (above, below), panel in zip(plots.T, experiment.panels, strict=True):
        _draw(above, panel, table, experiment.band, shown, against="iteration")
        _draw(below, panel, table, experiment.band, shown, against="exploration episodes")
        legend_above(above, panel.title)
    return figure


def styles_of(experiment: Experiment) -> dict[str, tuple[str, str, str]]:
    """Return the style of each curve by label; a method has one style in all panels, in the RKHS and on a grid.

    If a panel shows a method in both spaces, each has a style of its own.
    """
    panels = [[curve.label for curve in panel.curves] for panel in experiment.panels]
    is_unique = all(len(set(map(_method, labels))) == len(labels) for labels in panels)
    methods = {each: _method(each) if is_unique else each for labels in panels for each in labels}
    distinct = dict.fromkeys(methods.values())
    by_method = dict(zip(distinct, looks(len(distinct)), strict=True))
    return {each: by_method[method] for each, method in methods.items()}


def _method(label: str) -> str:
    """Return the name of a method without its space of policies: RKHS-NAC and eNAC are both NAC."""
    return PREFIX.sub("", label)


def _draw(
    axes: Axes, panel: Panel, table: Table, band: str, shown: Mapping[str, tuple[str, str, str]], against: str
) -> None:
    for curve in panel.curves:
        style, colour, _ = shown[curve.label]
        returns = table[panel.title, curve.label]
        x = returns.episodes if against.startswith("exploration") else np.arange(1, len(returns.episodes) + 1)
        low, high = _band(returns, band)
        axes.fill_between(x, low, high, color=colour, alpha=0.15, linewidth=0)
        axes.plot(x, returns.evaluation.mean(axis=0), style, color=colour, label=curve.label, linewidth=1.5)
    draw_references(axes, references(panel.curves[0].run(0).task))
    label(axes, against, "discounted return")


def _band(returns: Returns, band: str) -> tuple[Array, Array]:
    """Return the limits of the band around the mean, clipped to the range of the runs."""
    earned = returns.evaluation
    if returns.runs == 1:
        return earned[0], earned[0]
    deviation = earned.std(axis=0, ddof=1)
    width = deviation if band == "sd" else CONFIDENCE * deviation / np.sqrt(returns.runs)
    mean, least, most = earned.mean(axis=0), earned.min(axis=0), earned.max(axis=0)
    return np.maximum(mean - width, least), np.minimum(mean + width, most)
