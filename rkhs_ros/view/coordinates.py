"""What a policy is drawn over: the numbers that are observed, or its inputs where one moment does not give those."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rkhs_ros.learning.episodes import Episodes
from rkhs_ros.policies.gaussian import GaussianPolicy
from rkhs_ros.rkhs.kernels import Array


@dataclass(frozen=True)
class Coordinates:
    """The coordinates of a policy: numbers observed, or, of one that looks back on a history, its inputs.

    Attributes:
        policy: the policy.
        names: of the numbers observed.
    """

    policy: GaussianPolicy
    names: tuple[str, ...]

    @property
    def are_observed(self) -> bool:
        """Whether they are what is observed in one moment."""
        return self.policy.inputs.history == 1

    @property
    def labels(self) -> list[str]:
        """What the coordinates are called."""
        return list(self.names) if self.are_observed else [f"input {i + 1}" for i in range(self.policy.mean.input_dim)]

    def of(self, episodes: Episodes) -> list[Array]:
        """Return the points visited in each episode, shape (steps, coordinates)."""
        values = episodes.observations if self.are_observed else episodes.seen_through(self.policy.inputs).observations
        return [points[going] for points, going in zip(values, episodes.mask, strict=True)]

    def inputs(self, points: Array) -> Array:
        """Return the policy's inputs at points of shape (k, coordinates)."""
        return self.policy.inputs.features(points) if self.are_observed else points

    def centres(self) -> Array | None:
        """Return the centres of the mean, shape (centres, coordinates); None where they are at no such points."""
        centres, inputs = self.policy.mean.centres, self.policy.inputs
        if not self.are_observed:
            return centres
        if inputs.degree:
            return None
        turned = len(inputs.columns)
        points = np.empty((len(centres), len(self.names)))
        points[:, inputs.columns] = np.arctan2(centres[:, :turned], centres[:, turned : 2 * turned])
        points[:, np.setdiff1d(np.arange(len(self.names)), inputs.columns)] = centres[:, 2 * turned :]
        return points
