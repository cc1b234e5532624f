"""Reproduction of experiments: runs, without repeating finished ones, the table of their returns, and the figure.

Each panel of a figure is plotted over iterations and over episodes, as in the paper.
"""

import re
from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes

from rkhs_ros.base.endings import RunError
from rkhs_ros.base.files import write_whole
from rkhs_ros.learning.iteration import Row
from rkhs_ros.paper.experiment import Experiment
from rkhs_ros.pictures.known import references
from rkhs_ros.pictures.style import draw_references, label, legend_above, looks, sheet, write
from rkhs_ros.runs.config import Config
from rkhs_ros.runs.curve import Curve
from rkhs_ros.studies.comparison import as_csv
from rkhs_ros.studies.grid import indexed_folder

Make = Callable[[Mapping[Path, Config]], Mapping[Path, str]]
CONFIDENCE = 1.96  # standard errors on both sides of 95 %
WIDTH_IN, HEIGHT_IN = 6.0, 7.6  # of a panel's two plots
DPI = 90
PREFIX = re.compile(r"^(RKHS-|e(?=[A-Z]))")  # of a method's name: its space of policies


Table = dict[tuple[str, str], list[list[Row]]]  # rows of each run, by panel and curve


def reproduce(experiment: Experiment, out: Path, make: Make, *, runs: int) -> Table:
    """Run an experiment, write the table of its returns to a CSV file named like it, and return them.

    The runs are indexed by settings and provenance; `make` starts or resumes them in their folders, and returns the
    errors of failed runs by folder.
    """
    curves = [(title, curve) for title, panel in experiment.panels.items() for curve in panel]
    configs = {(title, curve.label, run): curve.run(run) for title, curve in curves for run in range(runs)}
    folders = {key: indexed_folder(out, config) for key, config in configs.items()}
    failures = make({folders[key]: config for key, config in configs.items()})
    for folder, why in failures.items():
        count = f"{len(failures)} of {len(folders)} runs failed; run the same command to continue"
        raise RunError(f"{folder}: {why} ({count})")
    table: Table = {}
    for (title, name, _), folder in folders.items():
        table.setdefault((title, name), []).append(Curve(folder / "curve.csv").rows())
    lines = [
        {"panel": title, "curve": name, "run": run, "iteration": row.iteration, "episodes": row.episodes}
        | {name: f"{getattr(row, name):.3f}" for name in ("exploration_return", "evaluation_return")}
        for (title, name), found in table.items()
        for run, rows in enumerate(found)
        for row in rows
    ]
    write_whole(out / f"{experiment.name}.csv", as_csv(lines).encode())
    return table


def draw_experiment(path: Path, experiment: Experiment, table: Table) -> None:
    """Draw the mean evaluation returns over the runs, with the band of the experiment."""
    runs = max(map(len, table.values()))
    band = "95 % confidence of the mean" if experiment.band == "confidence" else "one standard deviation of the runs"
    subtitle = f"evaluation return, mean of {runs} runs; band: {band}, within the range of the runs"
    columns = len(experiment.panels)
    figure = sheet(WIDTH_IN * columns, HEIGHT_IN, f"{experiment.title}\n{subtitle}")
    plots = figure.subplots(2, columns, sharey="col", squeeze=False)
    shown = styles_of(experiment)
    for pair, (title, curves) in zip(plots.T, experiment.panels.items(), strict=True):
        for axes, against in zip(pair, ("iteration", "exploration episodes"), strict=True):
            for curve in curves:
                _draw(axes, table[title, curve.label], experiment.band, curve.label, shown[curve.label], against)
            draw_references(axes, references(curves[0].run(0).task))
            label(axes, against, "discounted return")
        legend_above(pair[0], title)
    write(path, figure, dpi=DPI)


def styles_of(experiment: Experiment) -> dict[str, tuple[str, str, str]]:
    """Return the style of each curve by label; a method has one style in all panels, in the RKHS and on a grid.

    If a panel shows a method in both spaces, each has a style of its own. RKHS-NAC and eNAC are both NAC.
    """
    panels = [[curve.label for curve in curves] for curves in experiment.panels.values()]
    methods = {each: PREFIX.sub("", each) for labels in panels for each in labels}
    if any(len({methods[each] for each in labels}) < len(labels) for labels in panels):
        methods = {each: each for each in methods}
    distinct = dict.fromkeys(methods.values())
    by_method = dict(zip(distinct, looks(len(distinct)), strict=True))
    return {each: by_method[method] for each, method in methods.items()}


def _draw(axes: Axes, runs: list[list[Row]], band: str, name: str, shown: tuple[str, str, str], against: str) -> None:
    """Draw the mean of the runs, and the band around it, clipped to the range of the runs."""
    style, colour, _ = shown
    earned = np.array([[row.evaluation_return for row in rows] for rows in runs])
    x = [row.iteration if against == "iteration" else row.episodes for row in runs[0]]
    mean, low, high = earned.mean(axis=0), earned.min(axis=0), earned.max(axis=0)
    if len(runs) > 1:
        deviation = earned.std(axis=0, ddof=1)
        width = deviation if band == "sd" else CONFIDENCE * deviation / np.sqrt(len(runs))
        low, high = np.maximum(mean - width, low), np.minimum(mean + width, high)
    axes.fill_between(x, low, high, color=colour, alpha=0.15, linewidth=0)
    axes.plot(x, mean, style, color=colour, label=name, linewidth=1.5)
