"""Draw the learning curve and the policy of a run from its folder, and the comparison of many runs."""

from collections.abc import Mapping
from itertools import cycle
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from rkhs_ros.base.validation import require
from rkhs_ros.learning.episodes import Episodes
from rkhs_ros.pictures.known import names_of, references, success_reward
from rkhs_ros.pictures.policy_figure import draw_attempts, policy_figure
from rkhs_ros.pictures.style import COLOURS, draw_references, label, legend_above, looks, sheet, whole_ticks, write
from rkhs_ros.policies.gaussian import GaussianPolicy
from rkhs_ros.policies.inputs import Names
from rkhs_ros.policies.spaces import Spaces
from rkhs_ros.policies.storage import Task, read_policy
from rkhs_ros.recordings.recording import FILE, faults_named, read_recording
from rkhs_ros.runs.curve import Curve, columns, evaluation_errors
from rkhs_ros.runs.report import last_policy
from rkhs_ros.studies.aggregates import mean_over_runs
from rkhs_ros.studies.comparison import Comparison, LearningCurve

MOST_ATTEMPTS = 10_000  # newest ones, which are drawn
FORMATS = (".png", ".pdf", ".svg")  # of a comparison
SIZE_IN, DPI = (4.8, 3.2), 200  # of a comparison, without the legend beside it
FEW = 30  # iterations up to which all points are marked
MARKER_SPACING = 0.15  # of more points in a comparison, relative to the plot's diagonal
Columns = Mapping[str, NDArray[Any]]  # of a learning curve, by name
NO_OTHERS: Mapping[str, Columns] = {}


def draw_run(folder: Path) -> list[Path]:
    """Draw curve.png and, from the recorded episodes, policy.png in a run's folder; return their paths.

    Raises:
        ValueError: there is no policy yet, or the folder is not that of a run.
    """
    policy, task, spaces = read_policy(last_policy(folder))
    figures = {
        folder / "curve.png": curve_figure(columns(Curve(folder / "curve.csv").rows()), task),
        folder / "policy.png": _policy_figure(folder, policy, task, spaces),
    }
    for path, figure in figures.items():
        write(path, figure)
    return list(figures)


def _policy_figure(folder: Path, policy: GaussianPolicy, task: Task, spaces: Spaces | None) -> Figure:
    """Return the figure of a policy; for one-step tasks, the figure of the attempts."""
    recording = read_recording(folder)
    with faults_named(folder / FILE):
        episodes = recording.last_episodes()
    widths = episodes.observations.shape[2], episodes.actions.shape[2]
    names, spaces = names_of(task, *widths, spaces), spaces or Spaces.unbounded(*widths)
    if task.horizon == 1:
        attempts = [each.episodes for each in recording.by_numbers().values() if each.batch.explore][-MOST_ATTEMPTS:]
        attempted = Episodes.concatenate(attempts)
        return attempts_figure(attempted, episodes, spaces, names, task.environment, success_reward(task))
    return policy_figure(policy, spaces, names, episodes, task.environment)


def curve_figure(
    curve: Columns, task: Task, others: Mapping[str, Columns] = NO_OTHERS, size: tuple[float, float] = (6.6, 4.6)
) -> Figure:
    """Return a figure of the returns per iteration, with the reference returns of the task.

    If there are other runs, their evaluation returns are drawn, too, and all curves are drawn over exploration
    episodes, since iterations of different runs are not comparable.
    """
    figure = sheet(*size, task.environment)
    axes = figure.subplots()
    across = "episodes" if others else "iteration"
    marker = "." if len(curve[across]) <= FEW else ""
    noisy, mean, modelled = {"color": COLOURS[1]}, {"color": COLOURS[0], "linewidth": 2}, {"color": COLOURS[2]}
    lines: list[tuple[str, Columns, str, dict[str, Any]]] = [
        ("exploration", curve, "exploration_return", noisy | {"marker": marker}),
        ("evaluation (policy mean)", curve, "evaluation_return", mean | {"marker": marker}),
        ("model rollouts", curve, "model_return", modelled | {"linewidth": 1, "linestyle": "--"}),
    ]
    for (name, other), colour in zip(others.items(), cycle(COLOURS[3:]), strict=False):
        lines.append((name, other, "evaluation_return", {"color": colour}))
    for name, some, column, look in lines:
        measured = np.isfinite(some[column])
        if measured.any():
            axes.plot(some[across][measured], some[column][measured], label=name, **look)
    _draw_errors(axes, curve, across)
    draw_references(axes, references(task))
    label(axes, "exploration episodes" if others else across, "discounted return")
    whole_ticks(axes)
    legend_above(axes)
    return figure


def _draw_errors(axes: Axes, curve: Columns, across: str) -> None:
    """Draw a band of one standard error around the evaluation returns."""
    measured = np.isfinite(curve["evaluation_return"])
    at, mean, error = (its[measured] for its in (curve[across], curve["evaluation_return"], evaluation_errors(curve)))
    axes.fill_between(at, mean - error, mean + error, color=COLOURS[0], alpha=0.2, linewidth=0, zorder=1)


def attempts_figure(
    attempts: Episodes, learnt: Episodes, spaces: Spaces, names: Names, title: str, success: float | None
) -> Figure:
    """Return a figure of the sampled actions of one-step episodes and of the final policy's, see `draw_attempts`."""
    succeeded = attempts.rewards[:, 0] > (np.inf if success is None else success)
    count = f", at least {succeeded.sum()} of them successful" if success is not None else ""
    more = f"; 2 of {len(names.actions)} actions" if len(names.actions) > 2 else ""
    figure = sheet(6.6, 5.0, f"{title}\n{len(attempts)} attempts{count}{more}")
    axes = figure.subplots()
    draw_attempts(axes, attempts, learnt, spaces, names, success)
    legend_above(axes)
    return figure


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
    cut = f", up to episode {comparison.limit}" if comparison.limit else ""
    label(axes, "exploration episodes", f"discounted {kind} return", comparison.task.environment + cut)
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
    line.set(marker=marker, markevery=MARKER_SPACING if len(mean) > FEW else None, markersize=4.5)


def _draw_optimum(axes: Axes, task: Task) -> None:
    """Draw the first known optimum; its label omits the source, which follows in brackets."""
    known = [(name, value) for name, value in references(task).items() if name.startswith("optimum")]
    for name, value in known[:1]:
        axes.axhline(value, color="0.35", linestyle="--", linewidth=1, label=name.partition(" (")[0], zorder=1)
