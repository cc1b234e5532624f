"""Draw the policy plot of the page: the mean action, the centres and the latest episodes."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from numpy.typing import NDArray

from rkhs_ros.learning.episodes import Episodes
from rkhs_ros.pictures.policy_coordinates import PolicyCoordinates
from rkhs_ros.pictures.style import COLOURS, SIGNED, UNSIGNED, colour_bar, label, legend_above, pixels, sheet
from rkhs_ros.policies.gaussian import GaussianPolicy
from rkhs_ros.policies.spaces import Spaces
from rkhs_ros.rkhs.kernels import Array

SIZE, DPI = (4.2, 4.9), 180  # inches
CELLS = 90  # along each side of the map
MARGIN = 0.06  # beyond the visited range, as a part of it
BLUE, RED, _, _, PALE, CENTRE, EPISODE, _ = COLOURS
FAINTEST = 0.15  # opacity of the oldest episode


class Choice(NamedTuple):
    """Indices of what to draw: the coordinates along x and y, and the action component."""

    x: int
    y: int
    action: int


@dataclass(frozen=True)
class Board:
    """A rendered policy plot, with the position of the newest episode in it.

    Attributes:
        image: RGB, shape (height, width, 3).
        points: position in the image before each step, from 0 to 1 rightwards and upwards, shape (steps, 2).
    """

    image: NDArray[np.uint8]
    points: Array


class Subject(NamedTuple):
    """The input of a policy plot.

    Attributes:
        title: title of the plot.
        coordinates: coordinates to draw the policy over.
        episodes: single episodes; the last one is the newest and is marked.
        spaces: spaces of the task.
        discount: discount factor of the returns.
    """

    title: str
    coordinates: PolicyCoordinates
    episodes: Sequence[Episodes]
    spaces: Spaces
    discount: float

    @property
    def actions(self) -> tuple[str, ...]:
        """Names of the action components."""
        return self.coordinates.names.actions


def draw(subject: Subject, choice: Choice) -> Board:
    """Draw a policy over one or two coordinates; for one-step tasks, draw the sampled actions."""
    figure, points = board_figure(subject, choice)
    image, axes = pixels(figure), figure.axes[0]
    ends = np.sort([axes.get_xlim(), axes.get_ylim()])
    positions = axes.transData.transform(np.clip(points, *ends.T)) / [image.shape[1], image.shape[0]]
    return Board(image, np.asarray(positions))


def board_figure(subject: Subject, choice: Choice) -> tuple[Figure, Array]:
    """Return the figure of a policy, and the newest episode in data coordinates of the axes, shape (steps, 2)."""
    figure = sheet(*SIZE, subject.title)
    figure.set_dpi(DPI)
    axes, policy = figure.subplots(), subject.coordinates.policy
    if subject.episodes[-1].horizon == 1 and len(subject.actions) > 1:
        points = _draw_attempts(axes, policy, subject)
    elif len(subject.coordinates.labels) == 1:
        points = _draw_line(axes, policy, subject, choice)
    else:
        points = _draw_map(axes, policy, subject, choice)
    legend_above(axes)
    return figure, points


def _draw_map(axes: Axes, policy: GaussianPolicy, subject: Subject, choice: Choice) -> Array:
    coordinates, pair = subject.coordinates, [choice.x, choice.y]
    visited = [coordinates.of(each)[0] for each in subject.episodes]
    centres = coordinates.centres()
    low, high = _range([points[:, pair] for points in visited])
    sides = [np.linspace(a, b, CELLS) for a, b in zip(low, high, strict=True)]
    grid = np.tile(np.median(visited[-1], axis=0), (CELLS**2, 1))
    grid[:, pair] = np.stack(np.meshgrid(*sides), axis=-1).reshape(-1, 2)
    mean = policy.mean(coordinates.inputs(grid))
    shown = subject.spaces.clip(mean)[:, choice.action].reshape(CELLS, CELLS)
    least, most = _limits(subject, choice.action)
    image = axes.pcolormesh(*sides, shown, cmap=SIGNED, vmin=least, vmax=most, shading="gouraud")
    colour_bar(axes, image, subject.actions[choice.action])
    _draw_episodes(axes, [points[:, pair] for points in visited], high - low)
    if centres is not None:
        axes.plot(*centres[:, pair].T, "o", color=CENTRE, mec="black", mew=0.5, markersize=4.5, label="centres")
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]))
    label(axes, coordinates.labels[choice.x], coordinates.labels[choice.y])
    return visited[-1][:, pair]


def _draw_episodes(axes: Axes, paths: Sequence[Array], sizes: Array) -> None:
    """Draw the paths of episodes; older ones are fainter."""
    for points, age in zip(paths, _ages(len(paths)), strict=True):
        broken = _broken(points, sizes)
        axes.plot(*broken.T, color=EPISODE, alpha=age, linewidth=1 + (age == 1), label="episodes" if age == 1 else None)


def _draw_line(axes: Axes, policy: GaussianPolicy, subject: Subject, choice: Choice) -> Array:
    coordinates, action = subject.coordinates, choice.action
    visited = [coordinates.of(each)[0] for each in subject.episodes]
    done = [each.actions[0][each.mask[0], action] for each in subject.episodes]
    (low,), (high,) = _range(visited)
    x = np.linspace(low, high, 4 * CELLS)
    inputs = coordinates.inputs(x[:, None])
    mean, sd = policy.mean(inputs)[:, action], np.sqrt(policy.variance(inputs)[:, action])
    least, most = _limits(subject, action)
    margin = MARGIN * (most - least)
    lower, upper, mean, *done = (np.clip(values, least, most) for values in (mean - sd, mean + sd, mean, *done))
    axes.fill_between(x, lower, upper, color=PALE, alpha=0.35, linewidth=0, label="exploration")
    axes.plot(x, mean, color=BLUE, linewidth=2.5, label="mean action")
    for points, actions, age in zip(visited, done, _ages(len(visited)), strict=True):
        axes.plot(points[:, 0], actions, ".", color=EPISODE, alpha=age, label="episodes" if age == 1 else None)
    centres = coordinates.centres()
    if centres is not None:
        heights = np.clip(policy.mean(policy.mean.centres)[:, action], least, most)
        axes.plot(centres[:, 0], heights, "o", color=CENTRE, mec="black", mew=0.5, markersize=5, label="centres")
    axes.set(xlim=(low, high), ylim=(least - margin, most + margin))
    label(axes, coordinates.labels[0], subject.actions[action])
    return np.stack([visited[-1][:, 0], done[-1]], axis=1)


def _draw_attempts(axes: Axes, policy: GaussianPolicy, subject: Subject) -> Array:
    """Draw the first two components of the sampled actions, coloured by return, and the mean action."""
    tried = subject.spaces.clip(np.concatenate([each.actions[:, 0] for each in subject.episodes]))[:, :2]
    returns = np.concatenate([each.returns(subject.discount) for each in subject.episodes])
    newest = subject.episodes[-1]
    inputs = newest.with_inputs(policy.inputs).observations[0]
    mean, sd = policy.mean(inputs)[0, :2], np.sqrt(policy.variance(inputs))[0, :2]
    norm = Normalize(min(0.0, float(returns.min())), max(float(returns.max()), 1e-9))
    dots: Any = {"edgecolors": "black", "linewidths": 0.5, "label": "attempts"}
    image = axes.scatter(tried[:, 0], tried[:, 1], 45, returns, cmap=UNSIGNED, norm=norm, **dots)
    colour_bar(axes, image, "return")
    bars: Any = {"color": RED, "capsize": 4, "linewidth": 2, "zorder": 3}
    axes.errorbar(mean[0], mean[1], xerr=sd[0], yerr=sd[1], fmt="D", label="mean action, exploration", **bars)
    low, high = _range([tried, np.stack([mean - sd, mean + sd])])  # the bounds may be far wider
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]))
    label(axes, subject.actions[0], subject.actions[1])
    return tried[-1:]


def _limits(subject: Subject, action: int) -> tuple[float, float]:
    """Return the bounds of an action component; if it has none, the range of the actions taken."""
    low, high = (float(bound.ravel()[action]) for bound in (subject.spaces.action_low, subject.spaces.action_high))
    if np.isfinite(high - low) and high > low:
        return low, high
    most = max(float(np.abs(each.actions[each.mask][:, action]).max()) for each in subject.episodes)
    return -most - 1e-9, most + 1e-9


def _range(visited: Sequence[Array]) -> tuple[Array, Array]:
    points = np.concatenate(visited)
    low, high = points.min(axis=0), points.max(axis=0)
    margin = MARGIN * np.where(high > low, high - low, np.maximum(np.abs(high), 1e-6))
    return low - margin, high + margin


def _broken(points: Array, sizes: Array) -> Array:
    """Return a line with gaps at jumps through most of the range, for example at a wrapped angle."""
    jumps = np.flatnonzero((np.abs(np.diff(points, axis=0)) > 0.6 * sizes).any(axis=1))
    return np.insert(points, jumps + 1, np.nan, axis=0)


def _ages(count: int) -> Array:
    """Return the opacity of each episode, the newest last."""
    return np.linspace(FAINTEST, 1.0, count) if count > 1 else np.ones(1)
