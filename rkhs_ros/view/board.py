"""The picture of a policy that hangs beside the task: its mean action, its centres, and the episodes that led to it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from numpy.typing import NDArray

from rkhs_ros.learning.episodes import Episodes
from rkhs_ros.pictures.style import COLOURS, SIGNED, UNSIGNED
from rkhs_ros.policies.spaces import Spaces
from rkhs_ros.rkhs.kernels import Array
from rkhs_ros.view.coordinates import Coordinates

SIZE, DPI = (5.6, 4.7), 150  # inches
AREA = (0.145, 0.14, 0.655, 0.7)  # left, bottom, width and height of the plot, in parts of the picture
BAR = (0.83, 0.14, 0.03, 0.7)  # of the colour bar, alike
CELLS = 90  # of the map, along each side
MARGIN = 0.06  # of the range visited, beyond it
BLUE, RED, _, _, PALE, CENTRE, EPISODE, _ = COLOURS
FAINTEST = 0.15  # opacity of the oldest episode


class Choice(NamedTuple):
    """What is drawn: the coordinates along x and y, and which number of the actions."""

    x: int
    y: int
    action: int


@dataclass(frozen=True)
class Board:
    """A picture, and where on it the points of its last episode are.

    Attributes:
        image: RGB, shape (height, width, 3).
        points: before each step, from 0 to 1 across and up the picture, shape (steps, 2).
    """

    image: NDArray[np.uint8]
    points: Array


class Subject(NamedTuple):
    """What the picture is of.

    Attributes:
        title: above it.
        coordinates: of the policy.
        episodes: one row each, the newest, whose points are marked, last.
        spaces: of the task; None where they are not known.
        discount: of the returns.
    """

    title: str
    coordinates: Coordinates
    episodes: Sequence[Episodes]
    spaces: Spaces | None
    discount: float

    @property
    def actions(self) -> tuple[str, ...]:
        """Names of the actions' numbers."""
        return self.coordinates.names.actions


def draw(subject: Subject, choice: Choice) -> Board:
    """Draw a policy: over one or two coordinates, or, of a task of one step, among the actions that were tried."""
    figure = Figure(figsize=SIZE, dpi=DPI, facecolor="white")
    canvas: Any = FigureCanvasAgg(figure)
    axes = figure.add_axes(AREA)
    figure.text(AREA[0], 0.95, subject.title, fontsize=13, fontweight="bold", va="center")
    if subject.episodes[-1].horizon == 1 and len(subject.actions) > 1:
        points = _draw_attempts(axes, subject)
    elif len(subject.coordinates.labels) == 1:
        points = _draw_line(axes, subject, choice)
    else:
        points = _draw_map(axes, subject, choice)
    entries = {"ncols": 4, "columnspacing": 1.2, "handlelength": 1.5, "handletextpad": 0.5, "fontsize": 10}
    axes.legend(loc="lower left", bbox_to_anchor=(0.0, 1.005), frameon=False, borderaxespad=0.1, **entries)
    axes.xaxis.label.set_fontsize(12)
    axes.yaxis.label.set_fontsize(12)
    canvas.draw()
    return Board(np.array(canvas.buffer_rgba())[:, :, :3], _on_picture(axes, points))


def _on_picture(axes: Axes, points: Array) -> Array:
    (left, right), (bottom, top) = axes.get_xlim(), axes.get_ylim()
    parts = (points - [left, bottom]) / [right - left, top - bottom]
    return np.asarray(np.array(AREA[:2]) + np.clip(parts, 0.0, 1.0) * np.array(AREA[2:]))


def _draw_map(axes: Axes, subject: Subject, choice: Choice) -> Array:
    coordinates, pair = subject.coordinates, [choice.x, choice.y]
    visited = [coordinates.of(each)[0] for each in subject.episodes]
    centres = coordinates.centres()
    low, high = _range([points[:, pair] for points in visited])
    sides = [np.linspace(a, b, CELLS) for a, b in zip(low, high, strict=True)]
    grid = np.tile(np.median(visited[-1], axis=0), (CELLS**2, 1))
    grid[:, pair] = np.stack(np.meshgrid(*sides), axis=-1).reshape(-1, 2)
    mean = coordinates.policy.mean(coordinates.inputs(grid))
    shown = (mean if subject.spaces is None else subject.spaces.clip(mean))[:, choice.action].reshape(CELLS, CELLS)
    least, most = _limits(subject, choice.action)
    image = axes.pcolormesh(*sides, shown, cmap=SIGNED, vmin=least, vmax=most, shading="gouraud")
    axes.figure.colorbar(image, cax=axes.figure.add_axes(BAR)).set_label(subject.actions[choice.action], fontsize=12)
    for points, age in zip(visited, _ages(len(visited)), strict=True):
        broken = _broken(points[:, pair], high - low)
        axes.plot(*broken.T, color=EPISODE, alpha=age, linewidth=1 + (age == 1), label="episodes" if age == 1 else None)
    if centres is not None:
        axes.plot(*centres[:, pair].T, "o", color=CENTRE, mec="black", mew=0.5, markersize=4.5, label="centres")
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]))
    axes.set(xlabel=coordinates.labels[choice.x], ylabel=coordinates.labels[choice.y])
    return visited[-1][:, pair]


def _draw_line(axes: Axes, subject: Subject, choice: Choice) -> Array:
    coordinates, action = subject.coordinates, choice.action
    visited = [coordinates.of(each)[0] for each in subject.episodes]
    done = [each.actions[0][each.mask[0], action] for each in subject.episodes]
    (low,), (high,) = _range(visited)
    x = np.linspace(low, high, 4 * CELLS)
    inputs = coordinates.inputs(x[:, None])
    mean, sd = coordinates.policy.mean(inputs)[:, action], np.sqrt(coordinates.policy.variance(inputs)[:, action])
    least, most = _limits(subject, action)
    room = MARGIN * (most - least)
    lower, upper, mean, *done = (np.clip(values, least, most) for values in (mean - sd, mean + sd, mean, *done))
    axes.fill_between(x, lower, upper, color=PALE, alpha=0.35, linewidth=0, label="exploration")
    axes.plot(x, mean, color=BLUE, linewidth=2.5, label="mean action")
    for points, actions, age in zip(visited, done, _ages(len(visited)), strict=True):
        axes.plot(points[:, 0], actions, ".", color=EPISODE, alpha=age, label="episodes" if age == 1 else None)
    centres = coordinates.centres()
    if centres is not None:
        heights = np.clip(coordinates.policy.mean(coordinates.policy.mean.centres)[:, action], least, most)
        axes.plot(centres[:, 0], heights, "o", color=CENTRE, mec="black", mew=0.5, markersize=5, label="centres")
    axes.set(xlim=(low, high), ylim=(least - room, most + room))
    axes.set(xlabel=coordinates.labels[0], ylabel=subject.actions[action])
    return np.stack([visited[-1][:, 0], done[-1]], axis=1)


def _draw_attempts(axes: Axes, subject: Subject) -> Array:
    """Draw the first two numbers of the actions tried, coloured by what they earned, and the mean action."""
    tried = np.concatenate([each.actions[:, 0, :2] for each in subject.episodes])
    if subject.spaces is not None:
        tried = subject.spaces.clip(np.concatenate([each.actions[:, 0] for each in subject.episodes]))[:, :2]
    earned = np.concatenate([each.returns(subject.discount) for each in subject.episodes])
    policy, newest = subject.coordinates.policy, subject.episodes[-1]
    inputs = newest.seen_through(policy.inputs).observations[0]
    mean, sd = policy.mean(inputs)[0, :2], np.sqrt(policy.variance(inputs))[0, :2]
    norm = Normalize(min(0.0, float(earned.min())), max(float(earned.max()), 1e-9))
    dots: Any = {"edgecolors": "black", "linewidths": 0.5, "label": "attempts"}
    image = axes.scatter(tried[:, 0], tried[:, 1], 45, earned, cmap=UNSIGNED, norm=norm, **dots)
    axes.figure.colorbar(image, cax=axes.figure.add_axes(BAR)).set_label("return", fontsize=12)
    bars: Any = {"color": RED, "capsize": 4, "linewidth": 2, "zorder": 3}
    axes.errorbar(mean[0], mean[1], xerr=sd[0], yerr=sd[1], fmt="D", label="mean action, exploration", **bars)
    (xlow, xhigh), (ylow, yhigh) = (_limits(subject, action) for action in (0, 1))
    room = MARGIN * np.array([xhigh - xlow, yhigh - ylow])
    axes.set(xlim=(xlow - room[0], xhigh + room[0]), ylim=(ylow - room[1], yhigh + room[1]))
    axes.set(xlabel=subject.actions[0], ylabel=subject.actions[1])
    return tried[-1:]


def _limits(subject: Subject, action: int) -> tuple[float, float]:
    """Return the bounds of an action; where it has none, the range of what was done."""
    if subject.spaces is not None:
        low, high = (float(bound.ravel()[action]) for bound in (subject.spaces.action_low, subject.spaces.action_high))
        if np.isfinite(high - low) and high > low:
            return low, high
    most = max(float(np.abs(each.actions[each.mask][:, action]).max()) for each in subject.episodes)
    return -most - 1e-9, most + 1e-9


def _range(visited: Sequence[Array]) -> tuple[Array, Array]:
    points = np.concatenate(visited)
    low, high = points.min(axis=0), points.max(axis=0)
    room = MARGIN * (high - low) + 1e-6
    return low - room, high + room


def _broken(points: Array, sizes: Array) -> Array:
    """Return a line with gaps where it jumps through most of the range, as an angle does that wraps."""
    jumps = np.flatnonzero((np.abs(np.diff(points, axis=0)) > 0.6 * sizes).any(axis=1))
    return np.insert(points, jumps + 1, np.nan, axis=0)


def _ages(count: int) -> Array:
    """Return the opacity of each of some episodes, the newest last."""
    return np.linspace(FAINTEST, 1.0, count) if count > 1 else np.ones(1)
