"""What a policy is drawn over: the numbers that are observed, or its inputs where one moment does not give those."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rkhs_ros.learning.episodes import Episodes
from rkhs_ros.pictures.known import Names, input_names
from rkhs_ros.pictures.slices import best_slice
from rkhs_ros.policies.gaussian import GaussianPolicy
from rkhs_ros.rkhs.kernels import Array


@dataclass(frozen=True)
class Coordinates:
    """The coordinates of a policy: numbers observed, or, of one that looks back on a history, its inputs.

    Attributes:
        policy: the policy.
        names: of the numbers observed and done.
    """

    policy: GaussianPolicy
    names: Names

    @property
    def are_observed(self) -> bool:
        """Whether they are what is observed in one moment."""
        return self.policy.inputs.history == 1

    @property
    def labels(self) -> tuple[str, ...]:
        """What the coordinates are called."""
        return self.names.observations if self.are_observed else input_names(self.policy.inputs, self.names)

    def of(self, episodes: Episodes) -> list[Array]:
        """Return the points visited in each episode, shape (steps, coordinates)."""
        values = episodes.observations if self.are_observed else episodes.seen_through(self.policy.inputs).observations
        return [points[going] for points, going in zip(values, episodes.mask, strict=True)]

    def inputs(self, points: Array) -> Array:
        """Return the policy's inputs at points of shape (k, coordinates)."""
        return self.policy.inputs.features(points) if self.are_observed else points

    def telling(self, episode: Episodes) -> tuple[int, int]:
        """Return the two coordinates that tell most of the first number of the actions in an episode."""
        points = self.of(episode)[0]
        if points.shape[1] < 3:
            return 0, points.shape[1] - 1
        across, up = best_slice(lambda some: self.policy.mean(self.inputs(some))[:, 0], points).columns
        return across, up

    def centres(self) -> Array | None:
        """Return the centres of the mean, shape (centres, coordinates); None where they are at no such points."""
        centres, inputs = self.policy.mean.centres, self.policy.inputs
        if not self.are_observed:
            return centres
        if inputs.degree:
            return None
        turned = len(inputs.columns)
        points = np.empty((len(centres), len(self.names.observations)))
        points[:, inputs.columns] = np.arctan2(centres[:, :turned], centres[:, turned : 2 * turned])
        points[:, np.setdiff1d(np.arange(len(self.names.observations)), inputs.columns)] = centres[:, 2 * turned :]
        return points
