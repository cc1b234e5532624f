"""The picture of a comparison: learning curves with their bands, to be put into a paper."""

from __future__ import annotations

from io import BytesIO
from itertools import cycle, product
from pathlib import Path

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from rkhs_ros.base.files import write_whole
from rkhs_ros.base.validation import require
from rkhs_ros.pictures.run_pictures import references
from rkhs_ros.runs.aggregates import mean_over_runs
from rkhs_ros.runs.comparison import Comparison, LearningCurve

FORMATS = (".png", ".pdf", ".svg")
# Okabe and Ito's colours, which the colour-blind tell apart; yellow last, which is faint on white.
COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000", "#F0E442")
LINES = ("-", "--", "-.", ":")
SIZE_IN, DPI = (6.8, 3.6), 200


def format_of(path: Path) -> str:
    """Return the format that a picture's name asks for.

    Raises:
        ValueError: none that is known.
    """
    require(path.suffix in FORMATS, f"{path}", f"a picture's name with {' or '.join(FORMATS)}", repr(path.suffix))
    return path.suffix[1:]


def draw_comparison(path: Path, comparison: Comparison) -> None:
    """Draw the mean return over the exploring episodes, with its 95 % interval over the runs.

    Raises:
        ValueError: the file's name ends like no format that is known.
        OSError: it cannot be written.
    """
    figure = Figure(figsize=SIZE_IN, layout="constrained")
    axes = figure.subplots()
    for curve, (line, colour) in zip(comparison.curves, cycle(product(LINES, COLOURS)), strict=False):
        _draw(axes, curve, colour, line)
    optimum = [(name, value) for name, value in references(comparison.task).items() if name.startswith("optimum")]
    for name, value in optimum[:1]:
        axes.axhline(value, color="0.4", linestyle="--", linewidth=1, label=name, zorder=1)
    some = any(curve.is_noise_free for curve in comparison.curves)
    axes.set(xlabel="exploring episodes", ylabel=f"{'noise-free' if some else 'exploring'} discounted return")
    axes.set_title(comparison.task.environment, fontsize=10)
    axes.grid(color="0.92", linewidth=0.6)
    axes.set_axisbelow(True)
    figure.legend(loc="outside right upper", frameon=False, fontsize=9)
    content = BytesIO()
    figure.savefig(content, format=format_of(path), dpi=DPI)
    write_whole(path, content.getvalue())


def _draw(axes: Axes, curve: LearningCurve, colour: str, line: str) -> None:
    mean, low, high = mean_over_runs(curve.returns)
    marker = "o" if len(curve.episodes) == 1 else None  # a line through one point is not seen
    label = curve.label if curve.is_noise_free else f"{curve.label} (exploring)"
    axes.fill_between(curve.episodes, low, high, color=colour, alpha=0.18, linewidth=0)
    axes.plot(curve.episodes, mean, line, color=colour, linewidth=1.6, marker=marker, label=label)
