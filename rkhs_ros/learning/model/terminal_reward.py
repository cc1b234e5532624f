"""The reward of a step that terminates an episode, such as a crash or a landing."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rkhs_ros.rkhs.kernels import Array
from rkhs_ros.rkhs.posterior import Posterior

FEWEST_ENDS = 5  # terminal steps; fewer cannot tell a function from chance
FOLDS = 10  # of the cross-validation; the evidence cannot compare functions of more numbers than there are ends
ALIKE = 0.1  # range of additional rewards that does not matter, relative to their mean
EXPLAINS = 0.6  # largest error on left-out ends, relative to that of their mean; without a pattern it is about 1


@dataclass(frozen=True)
class TerminalReward:
    """The reward that a terminal step earns in addition to that of a step that goes on.

    Attributes:
        mean: its mean over the observed terminal steps.
        posterior: posterior of it as a function of the final observation's features and the action; None if they do
            not explain it.
        limits: smallest and largest observed reward of a terminal step, which limit the function.
    """

    mean: float = 0.0
    posterior: Posterior | None = None
    limits: tuple[float, float] = (0.0, 0.0)

    @classmethod
    def fit(cls, points: Array, extra: Array, rewards: Array, ordinary: float, centres: int) -> TerminalReward:
        """Fit the additional rewards of terminal steps.

        Args:
            points: features of the final observations and clipped actions, shape (n, p), n at least 1.
            extra: additional rewards, shape (n,).
            rewards: whole rewards of the terminal steps, shape (n,).
            ordinary: range of the rewards of other steps; ends whose rewards differ by less are considered alike.
            centres: maximum number of centres of the posterior.
        """
        mean = float(extra.mean())
        are_alike = np.ptp(extra) <= max(ordinary, ALIKE * abs(mean))
        if are_alike or len(extra) < FEWEST_ENDS or not _is_explained(points, extra, centres):
            return cls(mean)
        posterior = Posterior.fit(points, extra[:, None], centres)
        return cls(mean, posterior, (float(rewards.min()), float(rewards.max())))

    def add(self, rewards: Array, points: Array) -> Array:
        """Add the terminal reward to the rewards of steps, shape (n,), that end at points of shape (n, p)."""
        if self.posterior is None:
            return rewards + self.mean
        no_noise = np.zeros((len(points), *self.posterior.coefficients.mean.T.shape))
        return np.clip(rewards + self.posterior.draw(no_noise)(points)[:, 0], *self.limits)


def _is_explained(points: Array, values: Array, centres: int) -> bool:
    """Return whether a function of the points predicts values that were left out much better than their mean."""
    fold = np.arange(len(points)) % FOLDS
    errors, from_mean = np.empty(len(points)), np.empty(len(points))
    for held in (fold == each for each in range(min(FOLDS, len(points)))):
        known = values[~held]
        function = Posterior.fit(points[~held], known[:, None], centres)
        predicted = np.clip(function.mean(points[held])[:, 0], known.min(), known.max())
        errors[held], from_mean[held] = values[held] - predicted, values[held] - known.mean()
    return bool(np.abs(errors).sum() < EXPLAINS * np.abs(from_mean).sum())
