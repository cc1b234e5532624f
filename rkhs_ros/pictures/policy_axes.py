"""Axes for drawing a policy: observations or inputs, of which some tell most about its actions."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from rkhs_ros.learning.episodes import Episodes
from rkhs_ros.learning.model.state_coordinates import StateCoordinates
from rkhs_ros.policies.gaussian import GaussianPolicy
from rkhs_ros.policies.inputs import Names, input_names
from rkhs_ros.policies.spaces import Spaces
from rkhs_ros.rkhs.kernels import Array

MOST_POINTS = 200  # maximum number of points for the selection
SHORTLIST = 20  # number of inputs whose pairs are all tried


@dataclass(frozen=True)
class PolicyAxes:
    """Axes of a policy: the components of an observation, or its inputs if they depend on a history.

    Two components on a circle about 0, such as a cosine and a sine, are one axis: their angle.
    """

    policy: GaussianPolicy
    names: Names
    state: StateCoordinates  # columns of the components, with the pairs on a circle
    radii: tuple[float, ...]  # of each circle

    @classmethod
    def of(cls, policy: GaussianPolicy, names: Names, episodes: Episodes) -> PolicyAxes:
        """Return the axes of a policy, with the circles on which the components in some episodes lie."""
        points = np.concatenate(_components(policy, episodes))
        state = StateCoordinates.of(points)
        radii = (float(np.hypot(points[:, i], points[:, j]).mean()) for i, j in state.circles)
        return cls(policy, names, state, tuple(radii))

    @property
    def labels(self) -> tuple[str, ...]:
        """Names of the axes."""
        policy, names = self.policy, self.names.observations
        if not _are_observed(policy):
            names = input_names(policy.inputs, self.names, policy.action_repeat)
        angles = {i: f"angle of ({names[i]}, {names[j]}) (rad)" for i, j in self.state.circles}
        return tuple(angles.get(column, names[column]) for column in self.state.columns)

    def visited(self, episodes: Episodes) -> list[Array]:
        """Return the points visited in each episode, shape (steps, axes)."""
        return [self._on_axes(points) for points in _components(self.policy, episodes)]

    def inputs(self, points: Array) -> Array:
        """Return the inputs of the policy at points of shape (k, axes)."""
        components = np.empty((len(points), self.state.size))
        components[:, self.state.columns] = points
        for (i, j), radius in zip(self.state.circles, self.radii, strict=True):
            angle = components[:, i].copy()
            components[:, i], components[:, j] = radius * np.cos(angle), radius * np.sin(angle)
        return self.policy.inputs.features(components) if _are_observed(self.policy) else components

    def most_informative(self, points: Array, spaces: Spaces, action: int = 0) -> tuple[tuple[int, int], float]:
        """Return the pair of axes that explains most of a component of the mean action, see `most_informative`."""
        return most_informative(lambda some: spaces.clip(self.policy.mean(self.inputs(some)))[:, action], points)

    def centres(self) -> Array | None:
        """Return the centres of the mean, shape (centres, axes); None if they are not points on these axes."""
        centres, inputs = self.policy.mean.centres, self.policy.inputs
        if not _are_observed(self.policy):
            return self._on_axes(centres)
        if inputs.degree:
            return None
        turned = len(inputs.columns)
        points = np.empty((len(centres), self.state.size))
        angles = np.arctan2(centres[:, :turned], centres[:, turned : 2 * turned])
        points[:, inputs.columns] = angles * (inputs.full_turns / (2.0 * np.pi))
        points[:, np.setdiff1d(np.arange(self.state.size), inputs.columns)] = centres[:, 2 * turned :]
        return self._on_axes(points)

    def _on_axes(self, components: Array) -> Array:
        turned = components.copy()
        for i, j in self.state.circles:
            turned[:, i] = np.arctan2(components[:, j], components[:, i])
        return turned[:, self.state.columns]


def _are_observed(policy: GaussianPolicy) -> bool:
    return policy.inputs.history == 1


def _components(policy: GaussianPolicy, episodes: Episodes) -> list[Array]:
    """Return the observations of each episode, or the inputs of the decision at each step."""
    values = episodes.observations
    if not _are_observed(policy):
        repeat = policy.action_repeat
        inputs = policy.inputs.unfold(values[:, ::repeat], episodes.actions[:, ::repeat])
        values = np.repeat(inputs, repeat, axis=1)[:, : episodes.horizon]
    return [points[mask] for points, mask in zip(values, episodes.mask, strict=True)]


def most_informative(action: Callable[[Array], Array], points: Array) -> tuple[tuple[int, int], float]:
    r"""Return the pair of inputs that explains most of an action at the visited points, and the explained share.

    .. math:: 1 - \frac{E (h(x) - h(m \text{ but for two columns of } x))^2}{Var\, h(x)}

    with the medians m. It is nan if the action is constant, and negative if the pair predicts worse than the mean. All
    pairs of the inputs that explain most individually are tried. Bandwidths are no substitute: they bound how fast the
    action may vary, not how much it varies.
    """
    some = points[np.linspace(0, len(points) - 1, min(len(points), MOST_POINTS)).round().astype(int)]
    alone = [_left(action, some, [i]) for i in range(points.shape[1])]
    shortlist = sorted(np.argsort(alone, kind="stable")[:SHORTLIST].tolist())
    left, pair = min((_left(action, some, pair), pair) for pair in combinations(shortlist, 2))
    variance = float(np.var(action(some)))
    return pair, 1.0 - left / variance if variance > 0.0 else float("nan")


def on_slice(points: Array, columns: Sequence[int], values: Array) -> Array:
    """Return points with values, shape (k, columns), in the given columns and the points' medians in all others."""
    held = np.tile(np.median(points, axis=0), (len(values), 1))
    held[:, list(columns)] = values
    return held


def _left(action: Callable[[Array], Array], points: Array, columns: Sequence[int]) -> float:
    held = on_slice(points, columns, points[:, list(columns)])
    return float(np.mean((action(points) - action(held)) ** 2))
