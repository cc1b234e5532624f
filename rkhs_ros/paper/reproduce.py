"""Reproduction of experiments: runs, without repeating finished ones, the table of their returns, and the figure.

Each panel of a figure is plotted over iterations and over episodes, as in the paper.
"""

import re
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from rkhs_ros.base.endings import RunError
from rkhs_ros.base.files import write_whole
from rkhs_ros.paper.experiment import Experiment, Panel
from rkhs_ros.pictures.known import references
from rkhs_ros.pictures.style import draw_references, label, legend_above, looks, sheet, write
from rkhs_ros.rkhs.kernels import Array
from rkhs_ros.runs.config import Config
from rkhs_ros.runs.curve import Curve
from rkhs_ros.studies.comparison import as_csv
from rkhs_ros.studies.grid import indexed_folder

Make = Callable[[Mapping[Path, Config]], Mapping[Path, str]]
CONFIDENCE = 1.96  # standard errors on both sides of 95 %
WIDTH_IN, HEIGHT_IN = 6.0, 7.6  # of a panel's two plots
DPI = 90
PREFIX = re.compile(r"^(RKHS-|e(?=[A-Z]))")  # of a method's name: its space of policies


class Returns(NamedTuple):
    """Returns of the runs of a curve.

    Attributes:
        episodes: number of exploration episodes up to each iteration, shape (iterations,).
        evaluation: mean discounted return of the evaluation episodes after the update, shape (runs, iterations).
    """

    episodes: Array
    evaluation: Array


Table = dict[tuple[str, str], Returns]  # by panel and curve


def reproduce(experiment: Experiment, out: Path, make: Make, *, runs: int) -> Table:
    """Run an experiment, write the table of its returns to a CSV file named like it, and return them.

    The runs are indexed by settings and provenance; `make` starts or resumes them in their folders, and returns the
    errors of failed runs by folder.

    Raises:
        RunError: a run failed.
    """
    curves = [(panel.title, curve) for panel in experiment.panels for curve in panel.curves]
    configs = {(title, curve.label, run): curve.run(run) for title, curve in curves for run in range(runs)}
    folders = {key: indexed_folder(out, config) for key, config in configs.items()}
    failures = make({folders[key]: config for key, config in configs.items()})
    for folder, why in failures.items():
        count = f"{len(failures)} of {len(folders)} runs failed; run the same command to continue"
        raise RunError(f"{folder}: {why} ({count})")
    found = {key: Curve(path / "curve.csv").rows() for key, path in folders.items()}
    lines = [
        {"panel": panel, "curve": curve, "run": run, "iteration": row.iteration, "episodes": row.episodes}
        | {name: f"{getattr(row, name):.3f}" for name in ("exploration_return", "evaluation_return")}
        for (panel, curve, run), rows in found.items()
        for row in rows
    ]
    write_whole(out / f"{experiment.name}.csv", as_csv(lines).encode())
    table = {}
    for title, curve in curves:
        each = [found[title, curve.label, run] for run in range(runs)]
        evaluation = np.array([[row.evaluation_return for row in rows] for rows in each])
        table[title, curve.label] = Returns(np.array([float(row.episodes) for row in each[0]]), evaluation)
    return table


def draw_experiment(path: Path, experiment: Experiment, table: Table) -> None:
    """Draw the mean evaluation returns over the runs, with the band of the experiment."""
    write(path, experiment_figure(experiment, table), dpi=DPI)


def experiment_figure(experiment: Experiment, table: Table) -> Figure:
    """Return the figure of an experiment."""
    runs = max(len(returns.evaluation) for returns in table.values())
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
    if len(earned) == 1:
        return earned[0], earned[0]
    deviation = earned.std(axis=0, ddof=1)
    width = deviation if band == "sd" else CONFIDENCE * deviation / np.sqrt(len(earned))
    mean, least, most = earned.mean(axis=0), earned.min(axis=0), earned.max(axis=0)
    return np.maximum(mean - width, least), np.minimum(mean + width, most)
