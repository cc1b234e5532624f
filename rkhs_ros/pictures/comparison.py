"""Draw a comparison for a paper: learning curves with confidence bands."""

from pathlib import Path

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from rkhs_ros.base.validation import require
from rkhs_ros.pictures.known import references
from rkhs_ros.pictures.style import label, looks, whole_ticks, write
from rkhs_ros.policies.storage import Task
from rkhs_ros.studies.aggregates import mean_over_runs
from rkhs_ros.studies.comparison import Comparison, LearningCurve

FORMATS = (".png", ".pdf", ".svg")
MARKER_SPACING = 0.15  # relative to the plot's diagonal
SIZE_IN, DPI = (4.8, 3.2), 200  # of the plot, without the legend beside it


def format_of(path: Path) -> str:
    """Return the image format of a file name."""
    require(path.suffix in FORMATS, f"{path}", f"a file name that ends in {' or '.join(FORMATS)}", repr(path.suffix))
    return path.suffix[1:]


def draw_comparison(path: Path, comparison: Comparison) -> None:
    """Draw the mean returns of a comparison against exploration episodes, with 95 % intervals over the runs."""
    figure = comparison_figure(comparison)
    write(path, figure, format=format_of(path), dpi=DPI, bbox_inches="tight", pad_inches=0.05)


def comparison_figure(comparison: Comparison) -> Figure:
    """Return a figure of the mean returns with their intervals; the legend is beside it, outside its size."""
    figure = Figure(figsize=SIZE_IN, facecolor="white")
    axes = figure.subplots()
    for curve, look in zip(comparison.curves, looks(len(comparison.curves)), strict=True):
        _draw_curve(axes, curve, *look)
    _draw_optimum(axes, comparison.task)
    kind = "evaluation" if any(curve.is_evaluation for curve in comparison.curves) else "exploration"
    label(axes, "exploration episodes", f"discounted {kind} return", comparison.task.environment)
    whole_ticks(axes)
    axes.set_xlim(left=0)
    axes.grid(color="0.93", linewidth=0.6)
    axes.set_axisbelow(True)
    title = "mean and 95 % interval" if any(len(curve.returns) > 1 for curve in comparison.curves) else None
    place = {"loc": "upper left", "bbox_to_anchor": (1.02, 1.0), "borderaxespad": 0.0}
    axes.legend(**place, frameon=False, fontsize=9, title=title, title_fontsize=8, alignment="left")
    return figure


def _draw_curve(axes: Axes, curve: LearningCurve, style: str, colour: str, marker: str) -> None:
    mean, low, high = mean_over_runs(curve.returns)
    name = curve.label if curve.is_evaluation else f"{curve.label} (exploration)"
    axes.fill_between(curve.episodes, low, high, color=colour, alpha=0.18, linewidth=0)
    (line,) = axes.plot(curve.episodes, mean, style, color=colour, linewidth=1.5, label=name)
    line.set(marker=marker, markevery=MARKER_SPACING, markersize=4.5)


def _draw_optimum(axes: Axes, task: Task) -> None:
    """Draw the first known optimum; its label omits the source, which follows in brackets."""
    known = [(name, value) for name, value in references(task).items() if name.startswith("optimum")]
    for name, value in known[:1]:
        axes.axhline(value, color="0.35", linestyle="--", linewidth=1, label=name.partition(" (")[0], zorder=1)
