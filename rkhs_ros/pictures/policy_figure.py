"""Draw a policy: its mean action over one or two axes, or the attempts of a one-step task; for figures and the page."""

from collections.abc import Sequence
from math import isnan

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure

from rkhs_ros.learning.episodes import Episodes
from rkhs_ros.pictures.policy_axes import PolicyAxes, on_slice
from rkhs_ros.pictures.style import COLOURS, SIGNED, UNSIGNED, colour_bar, label, legend_above, sheet
from rkhs_ros.policies.gaussian import GaussianPolicy
from rkhs_ros.policies.inputs import Names
from rkhs_ros.policies.spaces import Spaces
from rkhs_ros.rkhs.kernels import Array

MOST_ACTIONS = 3  # with a plot
MOST_EPISODES = 6  # drawn
PANEL, LEAST_WIDTH, HEIGHT = 4.6, 6.6, 4.6  # inches
CELLS = 90  # along each side of a map
MARGIN = 0.06  # beyond the visited range, as a part of it
JUMP = 0.6  # of the range: steps farther apart are not joined, for example at a wrapped angle
BLUE, RED, GREEN, _, PALE, EPISODE = COLOURS[:6]
FAINTEST = 0.15  # opacity of the oldest episode


def policy_figure(policy: GaussianPolicy, spaces: Spaces, names: Names, episodes: Episodes, title: str) -> Figure:
    """Return a figure of the mean action over the policy's inputs and of episodes, with a plot for each action.

    One or two inputs are drawn completely. With more inputs, the upper plot is a slice through the medians of the
    visited points, along the two inputs that explain most of the action there; the lower plot is the action over time.
    The episodes are as observed, of at least one step.
    """
    view = PolicyAxes.of(policy, names, episodes)
    count = len(view.labels)
    singles = [episodes.take(slice(i, i + 1)) for i in range(min(len(episodes), MOST_EPISODES))]
    shown, rows = min(len(names.actions), MOST_ACTIONS), 1 if count <= 2 else 2
    some = f", {shown} of {len(names.actions)} actions" if shown < len(names.actions) else ""
    figure = sheet(max(PANEL * shown, LEAST_WIDTH), HEIGHT * (1.0, 1.5)[rows - 1], f"{title}\npolicy mean{some}")
    panels = figure.subplots(rows, shown, squeeze=False, gridspec_kw={"height_ratios": (2, 1)[:rows]})
    visited = np.concatenate(view.visited(episodes))
    for action in range(shown):
        pair, about = (0, count - 1), ""
        if rows > 1:
            pair, explained = view.most_informative(visited, spaces, action)
            share = "all" if isnan(explained) else f"{explained:.0%}" if explained > 0.0 else "little"
            about = f"2 of {count} inputs, which explain {share} of the action"
            _draw_times(panels[1, action], view, spaces, singles[-1], action)
        draw_policy(panels[0, action], view, spaces, singles, pair, action)
        legend_above(panels[0, action], about)
    return figure


def draw_policy(
    axes: Axes, view: PolicyAxes, spaces: Spaces, episodes: Sequence[Episodes], pair: tuple[int, int], action: int
) -> Array:
    """Draw a component of the mean action over one axis of the policy or two; return the newest episode in the plot."""
    visited, is_line = [view.visited(each)[0] for each in episodes], len(view.labels) == 1
    if is_line:
        _draw_line(axes, view, spaces, visited, action)
        taken = [spaces.clip(each.actions[0][each.mask[0]])[:, action] for each in episodes]
        paths = [np.column_stack([points[:, 0], actions]) for points, actions in zip(visited, taken, strict=True)]
    else:
        _draw_map(axes, view, spaces, visited, pair, action)
        paths = [points[:, pair] for points in visited]
    low, high = _range(paths)
    for path, age in zip(paths, np.linspace(1.0 if len(paths) == 1 else FAINTEST, 1.0, len(paths)), strict=True):
        shown, newest = path if is_line else _broken(path, high - low), path is paths[-1]
        name = "episodes" if newest else None
        axes.plot(*shown.T, "." if is_line else "-", color=EPISODE, alpha=age, linewidth=1 + newest, label=name)
    return paths[-1]


def _draw_map(
    axes: Axes, view: PolicyAxes, spaces: Spaces, visited: Sequence[Array], pair: tuple[int, int], action: int
) -> None:
    low, high = _range([points[:, pair] for points in visited])
    sides = [np.linspace(a, b, CELLS) for a, b in zip(low, high, strict=True)]
    grid = np.stack(np.meshgrid(*sides), axis=-1).reshape(-1, 2)
    mean = spaces.clip(view.policy.mean(view.inputs(on_slice(visited[-1], pair, grid))))[:, action]
    size, (least, most) = float(np.abs(mean).max()) or 1.0, _bounds(spaces, action)
    has_signs = least < 0.0 < most
    norm = Normalize(-size, size) if has_signs else Normalize(float(mean.min()), float(mean.max()))
    colours = SIGNED if has_signs else UNSIGNED
    image = axes.pcolormesh(*sides, mean.reshape(CELLS, CELLS), cmap=colours, norm=norm, shading="gouraud")
    colour_bar(axes, image, view.names.actions[action])
    centres = view.centres()
    if centres is not None:
        axes.plot(*centres[:, pair].T, "o", color="black", mec="white", mew=0.5, markersize=4.5, label="centres")
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]))
    label(axes, view.labels[pair[0]], view.labels[pair[1]])


def _draw_line(axes: Axes, view: PolicyAxes, spaces: Spaces, visited: Sequence[Array], action: int) -> None:
    (low,), (high,) = _range(visited)
    x, policy = np.linspace(low, high, 4 * CELLS), view.policy
    inputs = view.inputs(x[:, None])
    mean, sd = policy.mean(inputs), np.sqrt(policy.variance(inputs))
    lower, middle, upper = (spaces.clip(values)[:, action] for values in (mean - sd, mean, mean + sd))
    axes.fill_between(x, lower, upper, color=PALE, alpha=0.35, linewidth=0, label="exploration")
    axes.plot(x, middle, color=BLUE, linewidth=2.5, label="mean action")
    centres = view.centres()
    if centres is not None:
        heights = spaces.clip(policy.mean(policy.mean.centres))[:, action]
        axes.plot(centres[:, 0], heights, "o", color="black", mec="white", mew=0.5, markersize=5, label="centres")
    axes.set_xlim(low, high)
    label(axes, view.labels[0], view.names.actions[action])


def _draw_times(axes: Axes, view: PolicyAxes, spaces: Spaces, episode: Episodes, action: int) -> None:
    mean = spaces.clip(view.policy.mean(view.inputs(view.visited(episode)[0])))[:, action]
    axes.plot(mean, color=BLUE, linewidth=1.2, marker="." if len(mean) < 2 else "")
    for bound in _bounds(spaces, action):
        if np.isfinite(bound):
            axes.axhline(bound, color="0.45", linestyle="--", linewidth=1)
    label(axes, "step of an episode", view.names.actions[action])


def draw_attempts(
    axes: Axes, attempts: Episodes, learnt: Episodes, spaces: Spaces, names: Names, success: float | None
) -> Array:
    """Draw the actions of one-step episodes, and those of the final policy.

    A single component is drawn against the reward. Of several components, the first two are drawn against each other,
    coloured by reward, those with higher rewards on top. Only successes have a reward above ``success``, if given.
    """
    is_single, rewards = len(names.actions) == 1, attempts.rewards[:, 0]
    tried, chosen = (
        np.column_stack([spaces.clip(each.actions[:, 0]), each.rewards[:, 0]])[:, :2] for each in (attempts, learnt)
    )
    norm = Normalize(min(float(rewards.min()), 0.0), float(rewards.max()) or 1.0)
    succeeded = rewards > (np.inf if success is None else success)
    looks = (("X", "none", "attempt", PALE, ~succeeded), ("o", "black", "certain success", GREEN, succeeded))
    for marker, edge, name, colour, which in looks:
        order = np.flatnonzero(which)[np.argsort(rewards[which], kind="stable")]
        x, y = tried[order].T
        if is_single and len(order):
            axes.plot(x, y, marker, color=colour, label=name)
        elif len(order):
            dots = axes.scatter(x, y, 30, rewards[order], marker=marker, cmap=UNSIGNED, norm=norm, label=name)
            dots.set(edgecolors=edge, linewidths=0.5)
    if not is_single:
        colour_bar(axes, ScalarMappable(norm, UNSIGNED), "reward")
    label(axes, *(names.actions[0], "reward") if is_single else names.actions[:2])
    axes.plot(*chosen.T, "*", color=RED, markeredgecolor="black", markersize=15, label="final policy", zorder=4)
    return chosen


def _bounds(spaces: Spaces, action: int) -> tuple[float, float]:
    return float(spaces.action_low.ravel()[action]), float(spaces.action_high.ravel()[action])


def _range(visited: Sequence[Array]) -> tuple[Array, Array]:
    points = np.concatenate(visited)
    low, high = points.min(axis=0), points.max(axis=0)
    margin = MARGIN * np.where(high > low, high - low, np.maximum(np.abs(high), 1e-6))
    return low - margin, high + margin


def _broken(points: Array, sizes: Array) -> Array:
    """Return a line with gaps at jumps through most of the range."""
    jumps = np.flatnonzero((np.abs(np.diff(points, axis=0)) > JUMP * sizes).any(axis=1))
    return np.insert(points, jumps + 1, np.nan, axis=0)
