"""3D sketch of a run: the paths of the last episodes, and the centres of the policy."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from rkhs_ros.learning.episodes import Episodes
from rkhs_ros.learning.training import Iteration
from rkhs_ros.policies.input_names import Names, default_names
from rkhs_ros.policies.spaces import Spaces
from rkhs_ros.rkhs.function import Function
from rkhs_ros.rkhs.kernels import Array
from rkhs_ros.sketches.policy_coordinates import PolicyCoordinates

SIZE = np.array([2.0, 2.0, 1.0])  # size of the bounding box along x, y and z, in metres
MOST_EPISODES, MOST_ATTEMPTS = 10, 100  # maximum number of episodes of several steps, and of one step
MOST_POINTS = 100  # per episode
MOST_CENTRES = 500
JUMP = 0.6  # share of a side of the box; a larger distance between two points means that an angle wraps


class Sketch(NamedTuple):
    """Points in a box that is centred at the origin, in metres.

    Attributes:
        axes: names of the quantities along x, y and z, with their ranges.
        paths: path of each episode, oldest first, split where it jumps, shape (points, 3) each.
        centres: centres of the policy, with its mean action as the height, shape (m, 3).
    """

    axes: tuple[str, str, str]
    paths: Sequence[Sequence[Array]]
    centres: Array


class _Points(NamedTuple):
    """Points in the units of the task, with columns for x, y and z."""

    names: tuple[str, str, str]
    paths: Sequence[Array]
    centres: Array


class Sketcher:
    """Creates sketches of a run.

    Owns the last episodes, the ranges so far, and the coordinates along x and y. These are the two coordinates that are
    most informative about the action. They are updated each time the number of iterations doubles.

    Args:
        spaces: spaces of the task.
        discount: discount factor of the returns.
    """

    def __init__(self, spaces: Spaces, discount: float) -> None:
        self._spaces = spaces
        self._discount = discount
        self._names = Names(
            spaces.observation_names or default_names("observation", spaces.observation_dim),
            spaces.action_names or default_names("action", spaces.action_dim),
        )
        self._recent: deque[Episodes] = deque(maxlen=MOST_EPISODES)
        self._pair, self._choose_at = (0, 0), 0
        self._ranges_of: tuple[str, ...] = ()

    def add(self, iteration: Iteration) -> None:
        """Add the evaluation episodes of an iteration, or the exploration episodes if there are none."""
        self._recent.append(iteration.evaluation if len(iteration.evaluation) else iteration.exploration)

    def sketch(self, iteration: Iteration) -> Sketch:
        """Return the sketch after an iteration, which must have been added."""
        points = self._attempts() if self._recent[-1].horizon == 1 else self._moving(iteration)
        if points.names != self._ranges_of:
            self._ranges_of, self._low, self._high = points.names, np.full(3, np.inf), np.full(3, -np.inf)
        everything = np.concatenate([*points.paths, points.centres])
        self._low = np.minimum(self._low, everything.min(axis=0))
        self._high = np.maximum(self._high, everything.max(axis=0))
        ranges = zip(points.names, self._low, self._high, strict=True)
        x, y, z = (f"{name}: {low:.3g} to {high:.3g}" for name, low, high in ranges)
        paths = [_parts(self._placed(path)) for path in points.paths]
        return Sketch((x, y, z), paths, self._placed(points.centres))

    def _attempts(self) -> _Points:
        """Return the actions of one-step episodes, with the return as the height."""
        names, actions = self._names.actions, [self._spaces.clip(each.actions[:, 0]) for each in self._recent]
        earned = np.concatenate([each.returns(self._discount) for each in self._recent])
        pair = (0, min(1, len(names) - 1))
        tried = np.column_stack([np.concatenate(actions)[:, pair], earned])[-MOST_ATTEMPTS:]
        return _Points((names[pair[0]], names[pair[1]], "return"), [*tried[:, None]], np.zeros((0, 3)))

    def _moving(self, iteration: Iteration) -> _Points:
        """Return the paths of episodes through two coordinates, with the action as the height."""
        coordinates = PolicyCoordinates(iteration.policy, self._names)
        if iteration.number >= self._choose_at:
            self._pair = coordinates.most_informative(self._recent[-1].take(slice(0, 1)))
            self._choose_at = 2 * iteration.number
        across, up = self._pair
        paths = [self._path(coordinates, each.take(slice(0, 1))) for each in self._recent]
        names = (coordinates.labels[across], coordinates.labels[up] if up != across else "-", self._names.actions[0])
        return _Points(names, paths, self._centres(coordinates, iteration.policy.mean))

    def _path(self, coordinates: PolicyCoordinates, episode: Episodes) -> Array:
        actions = self._spaces.clip(episode.actions[0][episode.mask[0]])
        return _thinned(self._above(coordinates.of(episode)[0], actions), MOST_POINTS)

    def _centres(self, coordinates: PolicyCoordinates, mean: Function) -> Array:
        centres = coordinates.centres()
        if centres is None or not len(centres):
            return np.zeros((0, 3))
        return _thinned(self._above(centres, self._spaces.clip(mean(mean.centres))), MOST_CENTRES)

    def _above(self, points: Array, actions: Array) -> Array:
        """Return columns for x, y and z; y is 0 if there is a single coordinate."""
        across, up = self._pair
        depths = points[:, up] if up != across else np.zeros(len(points))
        return np.column_stack([points[:, across], depths, actions[:, 0]])

    def _placed(self, points: Array) -> Array:
        sides = np.where(self._high > self._low, self._high - self._low, 1.0)
        return np.asarray(SIZE * ((points - self._low) / sides - 0.5))


def _thinned(points: Array, most: int) -> Array:
    """Return a bounded number of evenly spaced points, including the first and the last."""
    return points.take(np.linspace(0, len(points) - 1, min(len(points), most)).round().astype(int), axis=0)


def _parts(path: Array) -> list[Array]:
    """Split a path where it jumps across most of the box."""
    jumps = np.flatnonzero((np.abs(np.diff(path, axis=0))[:, :2] > JUMP * SIZE[:2]).any(axis=1))
    return np.split(path, jumps + 1)
