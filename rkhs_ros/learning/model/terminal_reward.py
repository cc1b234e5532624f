"""The reward of a step that terminates an episode, such as a crash or a landing."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rkhs_ros.rkhs.kernels import Array
from rkhs_ros.rkhs.posterior import Posterior

FEWEST_ENDS = 5  # terminal steps to fit a function to; with fewer, a pattern may be chance
FOLDS = 10  # of the cross-validation; the evidence cannot compare functions with more parameters than there are ends
ALIKE = 0.1  # range of the additional rewards, relative to their mean, up to which ends are considered alike
EXPLAINS = 0.6  # largest error on left-out ends, relative to predicting the mean; about 1 without a pattern


@dataclass(frozen=True)
class TerminalReward:
    """The reward that a terminal step earns in addition to the predicted reward of a non-terminal step.

    Attributes:
        mean: mean additional reward of the observed terminal steps, used if there is no posterior.
        posterior: posterior of the additional reward as a function of the final observation's features and the action;
            None if they do not explain it.
        limits: smallest and largest observed reward of a terminal step; sums with the posterior are clipped to them.
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
            rewards: total rewards of the terminal steps, shape (n,).
            ordinary: range (maximum minus minimum) of the rewards of other steps; ends whose additional rewards differ
                by at most this range are considered alike.
            centres: maximum number of centres of the posterior.
        """
        mean = float(extra.mean())
        are_alike = np.ptp(extra) <= max(ordinary, ALIKE * abs(mean))
        if are_alike or len(extra) < FEWEST_ENDS or not _is_explained(points, extra, centres):
            return cls(mean)
        posterior = Posterior.fit(points, extra[:, None], centres)
        return cls(mean, posterior, (float(rewards.min()), float(rewards.max())))

    def add(self, rewards: Array, points: Array) -> Array:
        """Return the total rewards of terminal steps, shape (n,).

        Args:
            rewards: predicted rewards without the additional one, shape (n,).
            points: features of the final observations and clipped actions, shape (n, p).
        """
        if self.posterior is None:
            return rewards + self.mean
        return np.clip(rewards + self.posterior.expected(len(points))(points)[:, 0], *self.limits)


def _is_explained(points: Array, values: Array, centres: int) -> bool:
    """Return whether a function of the points predicts left-out values much better than the mean of the others does."""
    fold = np.arange(len(points)) % FOLDS
    errors, from_mean = np.empty(len(points)), np.empty(len(points))
    for held in (fold == each for each in range(min(FOLDS, len(points)))):
        known = values[~held]
        function = Posterior.fit(points[~held], known[:, None], centres)
        predicted = np.clip(function.mean(points[held])[:, 0], known.min(), known.max())
        errors[held], from_mean[held] = values[held] - predicted, values[held] - known.mean()
    return bool(np.abs(errors).sum() < EXPLAINS * np.abs(from_mean).sum())
