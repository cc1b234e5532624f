"""What a policy is drawn over: the numbers that are observed, or its inputs where one moment does not give those."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rkhs_ros.learning.episodes import Episodes
from rkhs_ros.policies.gaussian import GaussianPolicy
from rkhs_ros.policies.input_names import Names, input_names
from rkhs_ros.policies.inputs import Inputs
from rkhs_ros.rkhs.informative_inputs import most_informative_inputs
from rkhs_ros.rkhs.kernels import Array


@dataclass(frozen=True)
class PolicyCoordinates:
    """The coordinates of a policy: numbers observed, or, of one that looks back on a history, its inputs.

    Attributes:
        policy: the policy; None where it is not known.
        names: of the numbers observed and done.
    """

    policy: GaussianPolicy | None
    names: Names

    @property
    def are_observed(self) -> bool:
        """Whether they are what is observed in one moment."""
        return self._inputs.history == 1

    @property
    def _inputs(self) -> Inputs:
        return self.policy.inputs if self.policy else Inputs()

    @property
    def labels(self) -> tuple[str, ...]:
        """What the coordinates are called."""
        return self.names.observations if self.are_observed else input_names(self._inputs, self.names)

    def of(self, episodes: Episodes) -> list[Array]:
        """Return the points visited in each episode, shape (steps, coordinates)."""
        values = episodes.observations if self.are_observed else episodes.with_inputs(self._inputs).observations
        return [points[going] for points, going in zip(values, episodes.mask, strict=True)]

    def inputs(self, points: Array) -> Array:
        """Return the policy's inputs at points of shape (k, coordinates)."""
        return self._inputs.features(points) if self.are_observed else points

    def telling(self, episode: Episodes) -> tuple[int, int]:
        """Return the two coordinates that tell most of the first number of the actions in an episode.

        Where the policy is not known these are the first two.
        """
        points, policy = self.of(episode)[0], self.policy
        if points.shape[1] < 3 or policy is None:
            return 0, min(points.shape[1] - 1, 1)
        across, up = most_informative_inputs(lambda some: policy.mean(self.inputs(some))[:, 0], points).columns
        return across, up

    def centres(self) -> Array | None:
        """Return the centres of the mean, shape (centres, coordinates); None where they are at no such points."""
        if self.policy is None:
            return None
        centres, inputs = self.policy.mean.centres, self._inputs
        if not self.are_observed:
            return centres
        if inputs.degree:
            return None
        turned = len(inputs.columns)
        points = np.empty((len(centres), len(self.names.observations)))
        points[:, inputs.columns] = np.arctan2(centres[:, :turned], centres[:, turned : 2 * turned])
        points[:, np.setdiff1d(np.arange(len(self.names.observations)), inputs.columns)] = centres[:, 2 * turned :]
        return points
