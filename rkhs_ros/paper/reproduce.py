"""Reproduction of experiments: runs, without repeating finished ones, the table of their returns, and the figure."""

import re
from collections.abc import Callable, Mapping
from itertools import cycle
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes

from rkhs_ros.base.endings import RunError
from rkhs_ros.base.files import write_whole
from rkhs_ros.learning.iteration import Row
from rkhs_ros.paper.experiment import Experiment
from rkhs_ros.pictures.known import references
from rkhs_ros.pictures.style import COLOURS, STYLES, draw_references, label, legend_above, looks, sheet, write
from rkhs_ros.runs.config import Config
from rkhs_ros.runs.curve import Curve
from rkhs_ros.studies.comparison import as_csv
from rkhs_ros.studies.grid import indexed_folder

Make = Callable[[Mapping[Path, Config]], Mapping[Path, str]]
CONFIDENCE = 1.96  # standard errors on both sides of 95 %
WIDTH_IN, HEIGHT_IN = 6.0, 4.6  # of a panel
DPI = 90
PREFIX = re.compile(r"^(RKHS-|e(?=[A-Z]))")  # of a method's name: its space of policies
PARAMETER = re.compile(r" \w+ = \S+$")  # at the end of a label: the kernel's


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
    plots = figure.subplots(1, columns, squeeze=False)[0]
    shown = styles_of(experiment)
    for axes, (title, curves) in zip(plots, experiment.panels.items(), strict=True):
        for curve in curves:
            _draw(axes, table[title, curve.label], experiment.band, curve.label, shown[curve.label])
        draw_references(axes, references(curves[0].run(0).task))
        sizes = sorted({rows[0].episodes for curve in curves for rows in table[title, curve.label]})
        label(axes, f"iteration of {' or '.join(map(str, sizes))} episodes", "discounted return")
        legend_above(axes, title)
    write(path, figure, dpi=DPI)


def styles_of(experiment: Experiment) -> dict[str, tuple[str, str]]:
    """Return the line style and the colour of each curve by label; a method has the same in all panels.

    If labels end in a parameter of the kernel, it has the colour, and the method the style. Otherwise a method has the
    same colour in the RKHS and on a grid, unless a panel shows both. RKHS-NAC and eNAC are both NAC.
    """
    panels = [[curve.label for curve in curves] for curves in experiment.panels.values()]
    labels = [each for its in panels for each in its]
    parameters = {each: found[0] for each in labels if (found := PARAMETER.search(each))}
    if len(parameters) == len(set(labels)):
        methods = {each: PARAMETER.sub("", each) for each in labels}
        styles = dict(zip(dict.fromkeys(methods.values()), cycle(STYLES), strict=False))
        colours = dict(zip(dict.fromkeys(parameters.values()), cycle(COLOURS), strict=False))
        return {each: (styles[methods[each]], colours[parameters[each]]) for each in labels}
    methods = {each: PREFIX.sub("", each) for each in labels}
    if any(len({methods[each] for each in its}) < len(its) for its in panels):
        methods = {each: each for each in labels}
    distinct = dict.fromkeys(methods.values())
    by_method = dict(zip(distinct, looks(len(distinct)), strict=True))
    return {each: by_method[method][:2] for each, method in methods.items()}


def _draw(axes: Axes, runs: list[list[Row]], band: str, name: str, shown: tuple[str, str]) -> None:
    """Draw the mean of the runs, and the band around it, clipped to the range of the runs."""
    style, colour = shown
    earned = np.array([[row.evaluation_return for row in rows] for rows in runs])
    x = [row.iteration for row in runs[0]]
    mean, low, high = earned.mean(axis=0), earned.min(axis=0), earned.max(axis=0)
    if len(runs) > 1:
        deviation = earned.std(axis=0, ddof=1)
        width = deviation if band == "sd" else CONFIDENCE * deviation / np.sqrt(len(runs))
        low, high = np.maximum(mean - width, low), np.minimum(mean + width, high)
    axes.fill_between(x, low, high, color=colour, alpha=0.15, linewidth=0)
    axes.plot(x, mean, style, color=colour, label=name, linewidth=1.5)
