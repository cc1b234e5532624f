"""Draw the pictures of a run from its folder: the learning curve and the policy."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from rkhs_ros.base.validation import require
from rkhs_ros.learning.episodes import Episodes
from rkhs_ros.pictures.attempts_figure import attempts_figure
from rkhs_ros.pictures.known import names_of, references, success_reward
from rkhs_ros.pictures.policy_figure import policy_figure
from rkhs_ros.pictures.style import COLOURS, draw_references, label, legend_above, sheet, whole_ticks, write
from rkhs_ros.policies.gaussian import GaussianPolicy
from rkhs_ros.policies.spaces import Spaces
from rkhs_ros.policies.storage import Task, read_policy
from rkhs_ros.recordings.recording import FILE, faults_named, read_recording
from rkhs_ros.runs.curve import Curve, columns

MOST_ATTEMPTS = 10_000  # newest ones, which are drawn
FEW = 30  # iterations up to which the points are marked


def draw_run(folder: Path) -> list[Path]:
    """Draw curve.png and, from the recorded episodes, policy.png in a run's folder; return their paths.

    Raises:
        ValueError: a file of the run is damaged.
        OSError: a file is missing, or a picture cannot be written.
    """
    policy, task, spaces = read_policy(folder / "policy.npz")
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
        episodes = _checked(recording.last_episodes(), policy)
    widths = episodes.observations.shape[2], episodes.actions.shape[2]
    names, spaces = names_of(task, *widths, spaces), spaces or Spaces.unbounded(*widths)
    if task.horizon == 1:
        attempts = [each.episodes for each in recording.finished if each.batch.explore][-MOST_ATTEMPTS:]
        attempted = Episodes.concatenate(attempts)
        return attempts_figure(attempted, episodes, spaces, names, task.environment, success_reward(task))
    return policy_figure(policy, spaces, names, episodes, task.environment)


def _checked(episodes: Episodes, policy: GaussianPolicy) -> Episodes:
    """Return episodes that a policy can have run, with a step to draw.

    Raises:
        ValueError: there is no step to draw, or the dimensions differ from those of the policy.
    """
    require(bool(episodes.mask[:1].any()), "recording", "an episode with at least one step", "none")
    widths = (episodes.observations.shape[2], episodes.actions.shape[2])
    expected = (policy.mean.input_dim, policy.mean.output_dim)
    got = (policy.inputs.dimension(*widths), widths[1])
    require(got == expected, "recording", f"episodes of a policy from {expected[0]} to {expected[1]} dimensions", got)
    return episodes


def curve_figure(curve: Mapping[str, NDArray[Any]], task: Task) -> Figure:
    """Return a figure of the returns per iteration, with the reference returns of the task.

    Args:
        curve: columns of curve.csv, by name.
        task: task of the run.
    """
    figure = sheet(6.6, 4.6, task.environment)
    axes = figure.subplots()
    iterations, mean = curve["iteration"], curve["evaluation_return"]
    evaluated = np.isfinite(mean)
    marker = "." if len(iterations) <= FEW else ""
    axes.plot(iterations, curve["exploration_return"], color=COLOURS[1], marker=marker, label="exploration")
    if evaluated.any():
        look: dict[str, Any] = {
            "color": COLOURS[0],
            "linewidth": 2,
            "marker": marker,
            "label": "evaluation (policy mean)",
        }
        axes.plot(iterations[evaluated], mean[evaluated], **look)
    modelled = np.isfinite(curve["model_return"])
    if modelled.any():
        look = {"color": COLOURS[2], "linewidth": 1, "linestyle": "--", "label": "model rollouts"}
        axes.plot(iterations[modelled], curve["model_return"][modelled], **look)
    draw_references(axes, references(task))
    label(axes, "iteration", "discounted return")
    whole_ticks(axes)
    legend_above(axes)
    return figure
