"""Figures of experiments, in the layout of the paper's: a plot for each panel, over iterations and over episodes."""

from __future__ import annotations

from pathlib import Path
from textwrap import wrap

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from rkhs_ros.paper.experiment import Experiment, Panel
from rkhs_ros.paper.table import Returns, Table
from rkhs_ros.pictures.run_pictures import references
from rkhs_ros.rkhs.kernels import Array

TITLE_CHARACTERS = 60  # that fit above one plot
CONFIDENCE = 1.96  # standard errors on both sides of 95 %


def draw_experiment(path: Path, experiment: Experiment, table: Table) -> None:
    """Draw the noise-free returns: their mean over the runs and the experiment's band."""
    columns = len(experiment.panels)
    figure = Figure(figsize=(5.6 * columns, 7.6), layout="constrained")
    plots = figure.subplots(2, columns, sharey="col", squeeze=False)
    for (above, below), panel in zip(plots.T, experiment.panels, strict=True):
        _draw(above, panel, table, experiment.band, against="iteration")
        _draw(below, panel, table, experiment.band, against="exploring episodes used")
        above.set_title(panel.title)
        above.legend(frameon=False, fontsize=8, loc="best")
    runs = max(returns.runs for returns in table.values())
    band = "95 % confidence of the mean" if experiment.band == "confidence" else "one standard deviation of the runs"
    width = TITLE_CHARACTERS * columns
    lines = [*wrap(experiment.title, width), *wrap(f"noise-free policy, mean of {runs} runs; band: {band}", width)]
    figure.suptitle("\n".join(lines), fontsize=11)
    figure.savefig(path, dpi=90)


def _draw(axes: Axes, panel: Panel, table: Table, band: str, against: str) -> None:
    for curve in panel.curves:
        returns = table[panel.title, curve.label]
        x = returns.episodes if against.startswith("exploring") else np.arange(1, len(returns.episodes) + 1)
        mean, width = returns.mean_policy.mean(axis=0), _width(returns, band)
        (line,) = axes.plot(x, mean, label=curve.label, linewidth=1.5)
        axes.fill_between(x, mean - width, mean + width, color=line.get_color(), alpha=0.15, linewidth=0)
    for name, value in references(panel.curves[0].run(0).task).items():
        axes.axhline(value, color="grey", linestyle="--", linewidth=1)
        axes.annotate(name, (0.0, value), xycoords=("axes fraction", "data"), va="bottom", color="grey", fontsize=7)
    axes.set(xlabel=against, ylabel="discounted return")


def _width(returns: Returns, band: str) -> Array:
    if returns.runs == 1:
        return np.zeros_like(returns.episodes)
    deviation = returns.mean_policy.std(axis=0, ddof=1)
    return np.asarray(deviation if band == "sd" else CONFIDENCE * deviation / np.sqrt(returns.runs))
