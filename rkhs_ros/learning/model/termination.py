"""Where the task terminates episodes: beyond limits of single features, or where a regression is positive."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rkhs_ros.rkhs.kernels import Array
from rkhs_ros.rkhs.posterior import Posterior


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
