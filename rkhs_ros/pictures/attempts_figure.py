"""The picture of a task of one step: what was tried, and what it earned."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from numpy.typing import NDArray

from rkhs_ros.learning.episodes import Episodes
from rkhs_ros.pictures.style import COLOURS, UNSIGNED, colour_bar, label, legend_above, sheet
from rkhs_ros.policies.input_names import Names
from rkhs_ros.policies.spaces import Spaces
from rkhs_ros.rkhs.kernels import Array

Flags = NDArray[np.bool_]


def attempts_figure(
    attempts: Episodes, learnt: Episodes, spaces: Spaces, names: Names, title: str, success: float | None
) -> Figure:
    """Return a figure of the actions tried, coloured by reward, and of those of the policy at the end.

    One number of the action is drawn against the reward; of more the first two against each other.

    Args:
        attempts: all that was tried.
        learnt: of the policy at the end.
        spaces: of the task; actions are drawn as it takes them, within their bounds.
        names: of the actions.
        title: what is learnt.
        success: reward that only a success exceeds; None where the task does not say.
    """
    rewards = attempts.rewards[:, 0]
    won = rewards > (np.inf if success is None else success)
    told = f", at least {won.sum()} of them successful" if success is not None else ""
    more = f"; 2 of {len(names.actions)} actions" if len(names.actions) > 2 else ""
    figure = sheet(6.6, 5.0, f"{title}\n{len(rewards)} attempts{told}{more}")
    axes = figure.subplots()
    tried, chosen = (spaces.clip(each.actions[:, 0]) for each in (attempts, learnt))
    if len(names.actions) == 1:
        _against_reward(axes, tried[:, 0], rewards, won)
        label(axes, names.actions[0], "reward")
        x, y = chosen[:, 0], learnt.rewards[:, 0]
    else:
        _plane(axes, tried[:, :2], rewards, won)
        label(axes, names.actions[0], names.actions[1])
        x, y = chosen[:, 0], chosen[:, 1]
    axes.plot(x, y, "*", color=COLOURS[1], markeredgecolor="black", markersize=15, label="the policy learnt", zorder=4)
    legend_above(axes)
    return figure


def _plane(axes: Axes, tried: Array, rewards: Array, won: Flags) -> None:
    """Draw attempts where they are in the plane of two actions; the better ones cover the others."""
    norm = Normalize(min(float(rewards.min()), 0.0), float(rewards.max()) or 1.0)
    for marker, edge, name, which in (("X", "none", "attempt", ~won), ("o", "black", "success, beyond doubt", won)):
        order = np.flatnonzero(which)[np.argsort(rewards[which], kind="stable")]
        x, y = tried[order].T
        if len(order):
            dots = axes.scatter(x, y, 30, rewards[order], marker=marker, cmap=UNSIGNED, norm=norm, label=name)
            dots.set(edgecolors=edge, linewidths=0.5)
    colour_bar(axes, ScalarMappable(norm, UNSIGNED), "reward")


def _against_reward(axes: Axes, tried: Array, rewards: Array, won: Flags) -> None:
    for marker, colour, name, which in (
        ("X", COLOURS[4], "attempt", ~won),
        ("o", COLOURS[2], "success, beyond doubt", won),
    ):
        if which.any():
            axes.plot(tried[which], rewards[which], marker, color=colour, label=name)
