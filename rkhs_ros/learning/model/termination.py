"""Where the task terminates episodes, beyond limits or where a regression is positive, and what that earns."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

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
        return np.clip(rewards + self.posterior.expected()(points)[:, 0], *self.limits)


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


@dataclass(frozen=True)
class Limits:
    """Limits of features beyond which an episode ends, as far as the observations so far show them.

    Tasks often end an episode when one quantity leaves a range. A few ends do not show which one, because a fall takes
    many features beyond their earlier values. So the limits are drawn: of as few features as explain all ends, each
    between the last value that did not end an episode and the first one that did.

    Attributes:
        beyond: whether a feature of a terminal observation lies beyond those of all others, shape (n, q).
        low: greatest terminal value below all others, or -inf, and the least value of the others, shape (2, q).
        high: least terminal value above all others, or inf, and the greatest value of the others, shape (2, q).
    """

    beyond: NDArray[np.bool_]
    low: Array
    high: Array

    @classmethod
    def of(cls, terminal: Array, others: Array) -> Limits | None:
        """Return the limits, or None if no feature of some terminal observation is beyond those of the others.

        Args:
            terminal: features of terminal observations, shape (n, q), n at least 1.
            others: features of other observations, shape (m, q), m at least 1.
        """
        least, greatest = others.min(axis=0), others.max(axis=0)
        below, above = terminal < least, terminal > greatest
        if not (below | above).any(axis=1).all():
            return None
        low = np.where(below, terminal, -np.inf).max(axis=0)
        high = np.where(above, terminal, np.inf).min(axis=0)
        return cls(below | above, np.stack([low, least]), np.stack([high, greatest]))

    def draw(self, random: np.random.Generator) -> Array:
        """Draw the lower and upper limits of all features, shape (2, q); infinite where a feature has none."""
        limits = np.stack([np.full_like(self.low[0], -np.inf), np.full_like(self.high[0], np.inf)])
        unexplained = self.beyond
        while len(unexplained):
            explained = unexplained.sum(axis=0)
            feature = random.choice(np.flatnonzero(explained == explained.max()))
            for side, (outer, inner) in enumerate((self.low[:, feature], self.high[:, feature])):
                if np.isfinite(outer):
                    limits[side, feature] = inner + random.random() * (outer - inner)
            unexplained = unexplained[~unexplained[:, feature]]
        return limits


def fit_termination(before: Array, after: Array, ended: NDArray[np.bool_], centres: int) -> Limits | Posterior | None:
    """Fit limits, or a regression to +1 for terminal and -1 for other observations if limits do not explain all ends.

    Terminal observations are rare. With equal weights the regression misses some of them; with equal total weight for
    both classes the boundary moves inwards. The square roots of the class weights are a compromise. If every step is
    terminal, the fit is +1 everywhere.

    Args:
        before: features of the observations before all steps, shape (n, q).
        after: features of the observations after them, shape (n, q).
        ended: whether the task terminated the episode after the step, shape (n,).
        centres: maximum number of centres of the regression.

    Returns:
        The fit; None if no step is terminal.
    """
    if not ended.any():
        return None
    limits = None if ended.all() else Limits.of(after[ended], np.concatenate([before, after[~ended]]))
    if limits is not None:
        return limits
    ends, goes_on = (max(int(which.sum()), 1) for which in (ended, ~ended))
    shares = np.sqrt(np.where(ended, 0.5 / ends, 0.5 / goes_on) * len(ended))
    return Posterior.fit(after, np.where(ended, 1.0, -1.0)[:, None], centres, shares)
