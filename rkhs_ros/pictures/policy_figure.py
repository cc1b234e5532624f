"""Draw the mean action of a policy over its inputs: over all of them, or over the two most informative ones."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from math import isnan

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.patheffects import withStroke

from rkhs_ros.learning.episodes import Episodes
from rkhs_ros.learning.model.state_coordinates import StateCoordinates
from rkhs_ros.pictures.policy_coordinates import PolicyCoordinates, most_informative_inputs, on_slice
from rkhs_ros.pictures.style import COLOURS, SIGNED, UNSIGNED, colour_bar, label, legend_above, sheet
from rkhs_ros.policies.gaussian import GaussianPolicy
from rkhs_ros.policies.inputs import Names
from rkhs_ros.policies.spaces import Spaces
from rkhs_ros.rkhs.kernels import Array

MOST_ACTIONS = 3  # with a plot
PANEL, LEAST_WIDTH, HEIGHT = 4.6, 6.6, 4.6  # inches
LINE_POINTS, PLANE_POINTS = 300, 150  # along each axis
MOST_DOTS = 300  # visited points drawn
LEAST_EXPLAINED = 0.3  # share of the action's variance below which a slice would show another policy
JUMP = 0.5  # of the range: steps farther apart are not joined, for example at a wrapped angle
HALO = [withStroke(linewidth=3.5, foreground="white")]


@dataclass(frozen=True)
class View:
    """A policy as a function of the plotted coordinates.

    Attributes:
        policy: policy to draw.
        spaces: spaces of the task, with the bounds of the actions.
        coordinates: coordinates of the policy.
        axes: the same coordinates, with pairs on a circle as one angle, to draw the policy over.
        episode: visited points of the first episode, shape (steps, d).
        visited: visited points of all episodes, shape (k, d).
    """

    policy: GaussianPolicy
    spaces: Spaces
    coordinates: PolicyCoordinates
    axes: CircleAxes
    episode: Array
    visited: Array

    @classmethod
    def of(cls, policy: GaussianPolicy, spaces: Spaces, names: Names, episodes: Episodes) -> View:
        """Return the view of a policy and of observed episodes."""
        coordinates = PolicyCoordinates(policy, names)
        points = coordinates.of(episodes)
        visited = np.concatenate(points)
        axes = CircleAxes.of(visited)
        return cls(policy, spaces, coordinates, axes, axes.angles(points[0]), axes.angles(visited))

    @property
    def inputs(self) -> tuple[str, ...]:
        """Names of the coordinates."""
        return self.axes.labels(self.coordinates.labels)

    @property
    def actions(self) -> tuple[str, ...]:
        """Names of the actions."""
        return self.coordinates.names.actions

    def act(self, points: Array) -> Array:
        """Return the mean actions at points, clipped to the bounds."""
        return self.spaces.clip(self.policy.mean(self._features(points)))

    def band(self, points: Array) -> tuple[Array, Array]:
        """Return the mean minus and plus one standard deviation of the exploration, clipped to the bounds."""
        features = self._features(points)
        mean, sd = self.policy.mean(features), np.sqrt(self.policy.variance(features))
        return self.spaces.clip(mean - sd), self.spaces.clip(mean + sd)

    def action(self, column: int) -> Callable[[Array], Array]:
        """Return one action component as a function of points."""
        return lambda points: self.act(points)[:, column]

    def bounds(self, column: int) -> tuple[float, float]:
        """Return the bounds of one action component."""
        return float(self.spaces.action_low.ravel()[column]), float(self.spaces.action_high.ravel()[column])

    @property
    def centres(self) -> Array:
        """The centres of the mean, shape (m, d); empty if they are not points of the plotted coordinates."""
        centres = self.coordinates.centres()
        return self.visited[:0] if centres is None else self.axes.angles(centres)

    def _features(self, points: Array) -> Array:
        return self.coordinates.inputs(self.axes.points(points))


def policy_figure(policy: GaussianPolicy, spaces: Spaces, names: Names, episodes: Episodes, title: str) -> Figure:
    """Return a figure of the mean action over the policy's inputs and of an episode, with a plot for each action.

    Pairs of inputs that lie on a circle, such as a cosine and a sine, are drawn as one angle.
    One or two inputs are drawn completely. With more inputs, the upper plot is a slice through the medians of the
    visited points, along the two inputs that explain most of the action there, or only these points if no two inputs
    explain it; the lower plot is the action over time.

    Args:
        policy: policy to draw.
        spaces: spaces of the task.
        names: names of the observations and actions.
        episodes: episodes as observed, of at least one step.
        title: name of the task.
    """
    view = View.of(policy, spaces, names, episodes)
    kind = {1: _line, 2: _plane}.get(len(view.inputs))
    shown, rows = min(len(view.actions), MOST_ACTIONS), 1 if kind else 2
    some = f", {shown} of {len(view.actions)} actions" if shown < len(view.actions) else ""
    figure = sheet(max(PANEL * shown, LEAST_WIDTH), HEIGHT * (1 if kind else 1.5), f"{title}\npolicy mean{some}")
    panels = figure.subplots(rows, shown, squeeze=False, gridspec_kw={"height_ratios": (2, 1)[:rows]})
    for column in range(shown):
        if kind:
            kind(panels[0, column], view, column)
        else:
            _slice(panels[0, column], view, column)
            _times(panels[1, column], view, column)
    return figure


def _line(axes: Axes, view: View, column: int) -> None:
    (x,) = _spans(np.concatenate([view.centres, view.visited]), LINE_POINTS)
    points, action = x[:, None], view.action(column)
    low, high = view.band(points)
    axes.fill_between(x, low[:, column], high[:, column], color=COLOURS[4], alpha=0.3, linewidth=0, label="exploration")
    axes.plot(x, action(points), color=COLOURS[0], linewidth=2, label="mean action")
    if len(view.centres):
        axes.plot(view.centres[:, 0], action(view.centres), ".", color="black", label="centres", zorder=3)
    axes.plot(view.episode[:, 0], action(view.episode), "o", mfc="none", color=COLOURS[1], label="an episode")
    label(axes, view.inputs[0], view.actions[column])
    legend_above(axes)


def _plane(axes: Axes, view: View, column: int) -> None:
    spans = _spans(np.concatenate([view.centres, view.visited]), PLANE_POINTS)
    action = view.action(column)
    values = action(_grid(spans)).reshape(PLANE_POINTS, PLANE_POINTS)
    _coloured(axes, spans, values, _norm(view, column, values), view.actions[column])
    if len(view.centres):
        axes.plot(*view.centres.T, "o", color="black", markeredgecolor="white", markersize=5, label="centres")
    axes.plot(*_unwrapped(view.episode).T, color="black", linewidth=1.5, path_effects=HALO, label="an episode")
    axes.plot(*view.episode[0], "o", color="white", markeredgecolor="black", label="its start")
    label(axes, view.inputs[0], view.inputs[1])
    legend_above(axes)


def _slice(axes: Axes, view: View, column: int) -> None:
    action = view.action(column)
    columns, explained = most_informative_inputs(action, view.visited)
    spans = _spans(view.visited[:, columns], PLANE_POINTS)
    values = action(on_slice(view.visited, columns, _grid(spans))).reshape(PLANE_POINTS, PLANE_POINTS)
    norm = _norm(view, column, np.concatenate([values.ravel(), action(view.visited)]))
    is_explained = not explained < LEAST_EXPLAINED  # nan if the action is constant
    if is_explained:
        _coloured(axes, spans, values, norm, view.actions[column])
    some = view.visited[np.linspace(0, len(view.visited) - 1, min(len(view.visited), MOST_DOTS)).astype(int)]
    x, y = some[:, columns].T
    dots = axes.scatter(x, y, 14, action(some), cmap=_map(norm), norm=norm, edgecolors="black", linewidths=0.4)
    title = f"the 2 of {len(view.inputs)} inputs that explain most: {_percent(explained)}; dots: visited"
    if not is_explained:
        colour_bar(axes, dots, view.actions[column])
        title = f"visited points; no 2 of {len(view.inputs)} inputs explain the action"
    label(axes, view.inputs[columns[0]], view.inputs[columns[1]], title)


def _times(axes: Axes, view: View, column: int) -> None:
    action = view.action(column)(view.episode)
    axes.plot(action, color=COLOURS[0], linewidth=1.2, marker="." if len(action) < 2 else "")
    for bound in np.unique(view.bounds(column)):
        if np.isfinite(bound):
            axes.axhline(bound, color="0.45", linestyle="--", linewidth=1)
    label(axes, "step of an episode", view.actions[column])


def _percent(explained: float) -> str:
    return "all, as it does not vary" if isnan(explained) else f"{explained:.0%}"


def _coloured(axes: Axes, spans: tuple[Array, ...], values: Array, norm: Normalize, name: str) -> None:
    image = axes.pcolormesh(*spans, values, cmap=_map(norm), norm=norm, shading="nearest", rasterized=True)
    colour_bar(axes, image, name)


def _norm(view: View, column: int, values: Array) -> Normalize:
    """Return the range of the colours: that of the actions; symmetric about 0 if the bounds have both signs."""
    low, high = view.bounds(column)
    size = float(np.abs(values).max()) or 1.0
    return Normalize(-size, size) if low < 0.0 < high else Normalize(float(values.min()), float(values.max()))


def _map(norm: Normalize) -> str:
    return SIGNED if norm.vmin == -(norm.vmax or 0.0) else UNSIGNED


def _grid(spans: tuple[Array, ...]) -> Array:
    return np.stack(np.meshgrid(*spans), axis=-1).reshape(-1, len(spans))


def _spans(points: Array, steps: int) -> tuple[Array, ...]:
    """Return evenly spaced numbers along each axis, over the range of the points with a margin."""
    low, high = points.min(axis=0), points.max(axis=0)
    margin = 0.05 * (high - low) + 1e-9 + 1e-6 * np.abs(high)
    return tuple(np.linspace(a, b, steps) for a, b in zip(low - margin, high + margin, strict=True))


def _unwrapped(path: Array) -> Array:
    """Return a path with gaps where a coordinate jumps through much of its range."""
    jumps = (np.abs(np.diff(path, axis=0)) > JUMP * np.ptp(path, axis=0)).any(axis=1) if len(path) > 3 else np.zeros(0)
    return np.insert(path, np.flatnonzero(jumps) + 1, np.nan, axis=0)


@dataclass(frozen=True)
class CircleAxes:
    """Axes of a plot over points whose pairs of columns on a circle about 0 are one axis each.

    Attributes:
        state: columns of the points, with the pairs on a circle.
        radii: radius of each circle.
    """

    state: StateCoordinates
    radii: tuple[float, ...]

    @classmethod
    def of(cls, points: Array) -> CircleAxes:
        """Find the pairs that lie on a circle at visited points, shape (k, d)."""
        state = StateCoordinates.of(points)
        return cls(state, tuple(float(np.hypot(points[:, i], points[:, j]).mean()) for i, j in state.circles))

    def labels(self, names: tuple[str, ...]) -> tuple[str, ...]:
        """Return the names of the axes, given the names of the columns."""
        angles = {i: f"angle of ({names[i]}, {names[j]}) (rad)" for i, j in self.state.circles}
        return tuple(angles.get(column, names[column]) for column in self.state.columns)

    def angles(self, points: Array) -> Array:
        """Return points of shape (k, d) on the axes, shape (k, axes)."""
        turned = points.copy()
        for i, j in self.state.circles:
            turned[:, i] = np.arctan2(points[:, j], points[:, i])
        return turned[:, self.state.columns]

    def points(self, angles: Array) -> Array:
        """Return the points, shape (k, d), at positions on the axes, shape (k, axes)."""
        points = np.empty((len(angles), self.state.size))
        points[:, self.state.columns] = angles
        for (i, j), radius in zip(self.state.circles, self.radii, strict=True):
            angle = points[:, i].copy()
            points[:, i], points[:, j] = radius * np.cos(angle), radius * np.sin(angle)
        return points
