"""Draw the attempts of a one-step task: the sampled actions and their rewards."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from numpy.typing import NDArray

from rkhs_ros.learning.episodes import Episodes
from rkhs_ros.pictures.style import COLOURS, UNSIGNED, colour_bar, label, legend_above, sheet
from rkhs_ros.policies.inputs import Names
from rkhs_ros.policies.spaces import Spaces
from rkhs_ros.rkhs.kernels import Array

Flags = NDArray[np.bool_]


def attempts_figure(
    attempts: Episodes, learnt: Episodes, spaces: Spaces, names: Names, title: str, success: float | None
) -> Figure:
    """Return a figure of the sampled actions and of the final policy's actions.

    A single action component is drawn against the reward. Of several components, the first two are drawn against each
    other, coloured by reward.

    Args:
        attempts: all episodes of the run.
        learnt: evaluation episodes of the final policy.
        spaces: spaces of the task; actions are clipped to their bounds.
        names: names of the action components.
        title: name of the task.
        success: reward that only successes exceed; None if the task does not define it.
    """
    rewards = attempts.rewards[:, 0]
    succeeded = rewards > (np.inf if success is None else success)
    count = f", at least {succeeded.sum()} of them successful" if success is not None else ""
    more = f"; 2 of {len(names.actions)} actions" if len(names.actions) > 2 else ""
    figure = sheet(6.6, 5.0, f"{title}\n{len(rewards)} attempts{count}{more}")
    axes = figure.subplots()
    tried, chosen = (spaces.clip(each.actions[:, 0]) for each in (attempts, learnt))
    if len(names.actions) == 1:
        _against_reward(axes, tried[:, 0], rewards, succeeded)
        label(axes, names.actions[0], "reward")
        x, y = chosen[:, 0], learnt.rewards[:, 0]
    else:
        _plane(axes, tried[:, :2], rewards, succeeded)
        label(axes, names.actions[0], names.actions[1])
        x, y = chosen[:, 0], chosen[:, 1]
    axes.plot(x, y, "*", color=COLOURS[1], markeredgecolor="black", markersize=15, label="final policy", zorder=4)
    legend_above(axes)
    return figure


def _plane(axes: Axes, tried: Array, rewards: Array, succeeded: Flags) -> None:
    """Draw the attempts over two action components, those with higher rewards on top."""
    norm = Normalize(min(float(rewards.min()), 0.0), float(rewards.max()) or 1.0)
    for marker, edge, name, which in (
        ("X", "none", "attempt", ~succeeded),
        ("o", "black", "certain success", succeeded),
    ):
        order = np.flatnonzero(which)[np.argsort(rewards[which], kind="stable")]
        x, y = tried[order].T
        if len(order):
            dots = axes.scatter(x, y, 30, rewards[order], marker=marker, cmap=UNSIGNED, norm=norm, label=name)
            dots.set(edgecolors=edge, linewidths=0.5)
    colour_bar(axes, ScalarMappable(norm, UNSIGNED), "reward")


def _against_reward(axes: Axes, tried: Array, rewards: Array, succeeded: Flags) -> None:
    for marker, colour, name, which in (
        ("X", COLOURS[4], "attempt", ~succeeded),
        ("o", COLOURS[2], "certain success", succeeded),
    ):
        if which.any():
            axes.plot(tried[which], rewards[which], marker, color=colour, label=name)
