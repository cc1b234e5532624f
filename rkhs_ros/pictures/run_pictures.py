"""Pictures of a run, made from its folder: the learning curve, and the policy over the state space."""

from __future__ import annotations

from collections.abc import Mapping
from io import BytesIO
from pathlib import Path
from typing import Any

import gymnasium
import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from numpy.typing import NDArray

from rkhs_ros.base.files import write_whole
from rkhs_ros.base.validation import require
from rkhs_ros.learning.episodes import Episodes
from rkhs_ros.policies.gaussian import GaussianPolicy
from rkhs_ros.policies.storage import Task, load_policy
from rkhs_ros.rkhs.kernels import Array
from rkhs_ros.runs.curve import Curve, columns
from rkhs_ros.runs.episode_files import load_episodes

mpl.rcParams["axes.spines.top"] = mpl.rcParams["axes.spines.right"] = False
REFERENCE_DISCOUNT = 0.99


def draw_run(folder: Path) -> list[Path]:
    """Draw curve.png and policy.png of a run from what it left in its folder; return them.

    Raises:
        ValueError: a file of the run is damaged.
        OSError: one is missing, or a picture cannot be written.
    """
    policy, task = load_policy(folder / "policy.npz")
    rows = Curve(folder / "curve.csv").rows()
    episodes = _episodes(folder / "episodes.npz", policy)
    pictures = [folder / "curve.png", folder / "policy.png"]
    _save(pictures[0], curve_figure(columns(rows), task))
    draw_policy(pictures[1], policy, episodes)
    return pictures


def _episodes(path: Path, policy: GaussianPolicy) -> Episodes:
    """Return the episodes in a file as the policy sees them.

    Raises:
        ValueError: there is no step to draw, or they are of other dimensions than the policy.
        OSError: the file cannot be read.
    """
    episodes = load_episodes(path).episodes
    require(bool(episodes.mask[:1].any()), f"{path}", "an episode of at least one step", "none")
    widths = (episodes.observations.shape[2], episodes.actions.shape[2])
    expected = (policy.mean.input_dim, policy.mean.output_dim)
    got = (policy.inputs.dimension(*widths), widths[1])
    require(got == expected, f"{path}", f"episodes of a policy from {expected[0]} to {expected[1]} dimensions", got)
    return episodes.seen_through(policy.inputs)


def curve_figure(curve: Mapping[str, NDArray[Any]], task: Task) -> Figure:
    """Return a figure of the returns per iteration, with the returns known for the task.

    Args:
        curve: columns of curve.csv by name.
        task: what was learnt.
    """
    figure = Figure(figsize=(7, 4.2), layout="constrained")
    axes = figure.subplots()
    iterations, mean = curve["iteration"], curve["mean_policy_return"]
    evaluated = np.isfinite(mean)
    axes.plot(iterations, curve["train_return"], color="tab:orange", label="with exploration")
    if evaluated.any():
        axes.plot(iterations[evaluated], mean[evaluated], color="tab:blue", linewidth=2, label="noise-free policy")
    for name, value in references(task).items():
        axes.axhline(value, color="grey", linestyle="--", linewidth=1)
        axes.annotate(
            name, (1.0, value), xycoords=("axes fraction", "data"), ha="right", va="bottom", color="grey", fontsize=8
        )
    axes.set(xlabel="iteration", ylabel="discounted return", title=task.environment)
    axes.legend(loc="lower right", frameon=False)
    return figure


def draw_policy(path: Path, policy: GaussianPolicy, episodes: Episodes) -> None:
    """Draw the mean action over the state space with its centres and an episode.

    One and two dimensions of observation are drawn whole; of more, what was seen and done in the episode.
    """
    figure = Figure(figsize=(7, 4.6), layout="constrained")
    axes = figure.subplots()
    length = int(episodes.mask[0].sum())
    draw = {1: _draw_line, 2: _draw_plane}.get(policy.mean.input_dim, _draw_times)
    draw(axes, policy, episodes.observations[0, :length])
    _save(path, figure)


def _save(path: Path, figure: Figure) -> None:
    content = BytesIO()
    figure.savefig(content, dpi=120)
    write_whole(path, content.getvalue(), sync=False)  # what it is drawn from is on the disk


def _draw_line(axes: Axes, policy: GaussianPolicy, episode: Array) -> None:
    centres = policy.mean.centres
    x = _span(np.concatenate([centres, episode]), 300)[0]
    mean, sd = policy.mean(x[:, None])[:, 0], np.sqrt(policy.variance(x[:, None])[:, 0])
    axes.fill_between(x, mean - sd, mean + sd, alpha=0.2, label="exploration, one standard deviation")
    axes.plot(x, mean, label="mean action")
    axes.plot(centres[:, 0], policy.mean(centres)[:, 0], "k.", label="centres")
    axes.plot(episode[:, 0], policy.mean(episode)[:, 0], "o-", mfc="none", color="tab:red", label="an episode")
    axes.set(xlabel="observation", ylabel="action", title="Policy")
    axes.legend(frameon=False)


def _draw_plane(axes: Axes, policy: GaussianPolicy, episode: Array) -> None:
    centres = policy.mean.centres
    x, y = _span(np.concatenate([centres, episode]), 120)
    grid = np.stack(np.meshgrid(x, y), axis=-1)
    mean = policy.mean(grid.reshape(-1, 2))[:, 0].reshape(len(y), len(x))
    limit = np.abs(policy.mean(episode)).max()
    image = axes.pcolormesh(x, y, mean, cmap="coolwarm", vmin=-limit, vmax=limit, shading="auto")
    axes.figure.colorbar(image, label="mean action")
    axes.plot(*centres.T, "k.", label="centres")
    axes.plot(*episode.T, color="tab:green", linewidth=2, label="an episode")
    axes.plot(*episode[0], "o", color="tab:green", label="its start")
    axes.set(xlabel="first observation", ylabel="second observation", title="Policy")
    axes.legend(loc="upper right")


def _draw_times(axes: Axes, policy: GaussianPolicy, episode: Array) -> None:
    newest = episode[:, -(episode.shape[1] // policy.inputs.history) :]
    axes.plot(newest, linewidth=1)
    axes.set(xlabel="step", ylabel="newest inputs (thin)", title="An episode")
    actions = axes.twinx()
    actions.plot(policy.mean(episode), color="black", linewidth=2)
    actions.set_ylabel("mean action (black)")
    axes.legend(
        handles=[Line2D([], [], color=f"C{i % 10}") for i in range(min(newest.shape[1], 10))],
        labels=[f"{i + 1}" for i in range(min(newest.shape[1], 10))],
        frameon=False,
    )


def _span(points: Array, steps: int) -> tuple[Array, ...]:
    low, high = points.min(axis=0), points.max(axis=0)
    margin = 0.05 * (high - low) + 1e-9
    return tuple(np.linspace(a, b, steps) for a, b in zip(low - margin, high + margin, strict=True))


def references(task: Task) -> dict[str, float]:
    """Return the returns known for a task at its registered horizon and discount, by name."""
    spec = gymnasium.registry.get(task.environment.rpartition(":")[2])
    if spec is None or (task.horizon, task.discount) != (spec.max_episode_steps, REFERENCE_DISCOUNT):
        return {}
    return getattr(spec.vector_entry_point, "reference_returns", {})
