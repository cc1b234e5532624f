"""A sketch of what is being learnt, in space: the paths of the last episodes, and the centres of the policy."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from rkhs_ros.learning.episodes import Episodes
from rkhs_ros.learning.training import Iteration
from rkhs_ros.policies.input_names import Names, plain_names
from rkhs_ros.policies.spaces import Spaces
from rkhs_ros.rkhs.function import Function
from rkhs_ros.rkhs.kernels import Array
from rkhs_ros.sketches.policy_coordinates import PolicyCoordinates

SIZE = np.array([2.0, 2.0, 1.0])  # of the box in which all of it stays, along x, y and z, in metres
MOST_EPISODES, MOST_ATTEMPTS = 10, 100  # that are drawn, of many steps and of one
MOST_POINTS = 100  # of an episode
MOST_CENTRES = 500
JUMP = 0.6  # of a side of the box, from one point to the next: of an angle that wraps


class Sketch(NamedTuple):
    """Points in a box whose middle is the origin, in metres.

    Attributes:
        axes: what runs along x, y and z, with the range from one side of the box to the other.
        paths: of each episode, the oldest first, shape (points, 3), in parts where it jumps.
        centres: of the policy, at the height of its mean action there, shape (m, 3).
    """

    axes: tuple[str, str, str]
    paths: Sequence[Sequence[Array]]
    centres: Array


class _Points(NamedTuple):
    """What is sketched, in the units of the task: columns for x, y and z."""

    names: tuple[str, str, str]
    paths: Sequence[Array]
    centres: Array


class Sketcher:
    """Sketches what a run came to.

    Owns the last episodes, the ranges that were seen so far, and which two numbers run along x and y: those that tell
    most of what the policy does, chosen anew each time that the number of iterations has doubled.

    Args:
        spaces: of the task.
        discount: of the returns.
    """

    def __init__(self, spaces: Spaces, discount: float) -> None:
        self._spaces = spaces
        self._discount = discount
        self._names = Names(
            spaces.observation_names or plain_names("observation", spaces.observation_dim),
            spaces.action_names or plain_names("action", spaces.action_dim),
        )
        self._recent: deque[Episodes] = deque(maxlen=MOST_EPISODES)
        self._pair, self._choose_at = (0, 0), 0
        self._ranges_of: tuple[str, ...] = ()

    def add(self, iteration: Iteration) -> None:
        """Take note of the episodes of an iteration: of the noise-free ones, where there are some."""
        self._recent.append(iteration.evaluation if len(iteration.evaluation) else iteration.exploration)

    def sketch(self, iteration: Iteration) -> Sketch:
        """Return what is to be seen after an iteration, which was added."""
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
        """Return the actions of episodes of one step, with the return as the height."""
        names, actions = self._names.actions, [self._spaces.clip(each.actions[:, 0]) for each in self._recent]
        earned = np.concatenate([each.returns(self._discount) for each in self._recent])
        pair = (0, min(1, len(names) - 1))
        tried = np.column_stack([np.concatenate(actions)[:, pair], earned])[-MOST_ATTEMPTS:]
        return _Points((names[pair[0]], names[pair[1]], "return"), [*tried[:, None]], np.zeros((0, 3)))

    def _moving(self, iteration: Iteration) -> _Points:
        """Return the paths of episodes through two coordinates, with the action as the height."""
        coordinates = PolicyCoordinates(iteration.policy, self._names)
        if iteration.number >= self._choose_at:
            self._pair = coordinates.telling(self._recent[-1].take(slice(0, 1)))
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
        """Return columns for x, y and z; of a task with a single number nothing runs along y."""
        across, up = self._pair
        depths = points[:, up] if up != across else np.zeros(len(points))
        return np.column_stack([points[:, across], depths, actions[:, 0]])

    def _placed(self, points: Array) -> Array:
        sides = np.where(self._high > self._low, self._high - self._low, 1.0)
        return np.asarray(SIZE * ((points - self._low) / sides - 0.5))


def _thinned(points: Array, most: int) -> Array:
    """Return at most so many of some points, evenly chosen, the first and the last among them."""
    return points.take(np.linspace(0, len(points) - 1, min(len(points), most)).round().astype(int), axis=0)


def _parts(path: Array) -> list[Array]:
    """Return a path in parts: it ends where it jumps through most of the box, and begins again."""
    jumps = np.flatnonzero((np.abs(np.diff(path, axis=0))[:, :2] > JUMP * SIZE[:2]).any(axis=1))
    return np.split(path, jumps + 1)
