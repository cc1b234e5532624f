"""Coordinates for drawing a policy: observations, or the inputs that tell most about its actions."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import NamedTuple

import numpy as np

from rkhs_ros.learning.episodes import Episodes
from rkhs_ros.policies.gaussian import GaussianPolicy
from rkhs_ros.policies.inputs import Names, input_names
from rkhs_ros.rkhs.kernels import Array

MOST_POINTS = 200  # maximum number of points for the selection
SHORTLIST = 20  # number of inputs whose pairs are all tried


@dataclass(frozen=True)
class PolicyCoordinates:
    """Coordinates of a policy: the components of an observation, or its inputs if they depend on a history.

    Attributes:
        policy: the policy.
        names: names of the components of observations and actions.
    """

    policy: GaussianPolicy
    names: Names

    @property
    def are_observed(self) -> bool:
        """Whether the coordinates are the components of a single observation."""
        return self.policy.inputs.history == 1

    @property
    def labels(self) -> tuple[str, ...]:
        """Names of the coordinates."""
        return (
            self.names.observations
            if self.are_observed
            else input_names(self.policy.inputs, self.names, self.policy.action_repeat)
        )

    def of(self, episodes: Episodes) -> list[Array]:
        """Return the points visited in each episode, shape (steps, coordinates)."""
        values = episodes.observations if self.are_observed else self._decided(episodes)
        return [points[mask] for points, mask in zip(values, episodes.mask, strict=True)]

    def _decided(self, episodes: Episodes) -> Array:
        """Return the inputs of the decision at each step, shape (N, H, inputs)."""
        repeat = self.policy.action_repeat
        inputs = self.policy.inputs.unfold(episodes.observations[:, ::repeat], episodes.actions[:, ::repeat])
        return np.repeat(inputs, repeat, axis=1)[:, : episodes.horizon]

    def inputs(self, points: Array) -> Array:
        """Return the inputs of the policy at points of shape (k, coordinates)."""
        return self.policy.inputs.features(points) if self.are_observed else points

    def most_informative(self, episode: Episodes) -> tuple[int, int]:
        """Return the two coordinates with the most information about the first action component in an episode."""
        points, policy = self.of(episode)[0], self.policy
        if points.shape[1] < 3:
            return 0, min(points.shape[1] - 1, 1)
        across, up = most_informative_inputs(lambda some: policy.mean(self.inputs(some))[:, 0], points).columns
        return across, up

    def centres(self) -> Array | None:
        """Return the centres of the mean, shape (centres, coordinates); None if they have other coordinates."""
        centres, inputs = self.policy.mean.centres, self.policy.inputs
        if not self.are_observed:
            return centres
        if inputs.degree:
            return None
        turned = len(inputs.columns)
        points = np.empty((len(centres), len(self.names.observations)))
        angles = np.arctan2(centres[:, :turned], centres[:, turned : 2 * turned])
        points[:, inputs.columns] = angles * (inputs.full_turns / (2.0 * np.pi))
        points[:, np.setdiff1d(np.arange(len(self.names.observations)), inputs.columns)] = centres[:, 2 * turned :]
        return points


Action = Callable[[Array], Array]  # from points, shape (k, d), to one component of the actions, shape (k,)


class InputPair(NamedTuple):
    """A plane through the median of the visited points.

    Attributes:
        columns: the two inputs that vary on the plane.
        explained: share of the action's variance over the visited points that remains when all other inputs are
            fixed at their medians; nan if the action is constant, negative if the plane predicts worse than the mean.
    """

    columns: tuple[int, int]
    explained: float


def most_informative_inputs(action: Action, points: Array) -> InputPair:
    r"""Return the pair of inputs that explains most of an action at the visited points.

    .. math:: 1 - \frac{E (h(x) - h(m \text{ but for two columns of } x))^2}{Var\, h(x)}

    with the medians m. All pairs of the inputs that explain most individually are tried. Bandwidths are no substitute:
    they bound how fast the action may vary, not how much it varies.

    Args:
        action: one component of the actions.
        points: visited points, shape (k, d) with d >= 2.
    """
    some = points[np.linspace(0, len(points) - 1, min(len(points), MOST_POINTS)).round().astype(int)]
    alone = [_left(action, some, [i]) for i in range(points.shape[1])]
    shortlist = sorted(np.argsort(alone, kind="stable")[:SHORTLIST].tolist())
    left, columns = min((_left(action, some, pair), pair) for pair in combinations(shortlist, 2))
    variance = float(np.var(action(some)))
    return InputPair(columns, 1.0 - left / variance if variance > 0.0 else float("nan"))


def on_slice(points: Array, columns: Sequence[int], values: Array) -> Array:
    """Return points with values, shape (k, columns), in the given columns and the points' medians in all others."""
    held = np.tile(np.median(points, axis=0), (len(values), 1))
    held[:, list(columns)] = values
    return held


def _left(action: Action, points: Array, columns: Sequence[int]) -> float:
    held = on_slice(points, columns, points[:, list(columns)])
    return float(np.mean((action(points) - action(held)) ** 2))
