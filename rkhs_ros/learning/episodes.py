"""Episodes: what was observed, done and earned, as plain arrays."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rkhs_ros.rkhs.kernels import Array
from rkhs_ros.rkhs.validation import require


@dataclass(frozen=True)
class Episodes:
    """N episodes of H steps.

    Attributes:
        observations: before each action, shape (N, H, d).
        actions: as drawn, before any clipping, shape (N, H, n).
        rewards: of each action, shape (N, H); 0 where an episode was over.
        mask: True where the episode was still going on, shape (N, H).
    """

    observations: Array
    actions: Array
    rewards: Array
    mask: NDArray[np.bool_]

    def __post_init__(self) -> None:
        """Raise ValueError where the shapes do not fit."""
        shape = self.rewards.shape
        for name in ("observations", "actions", "mask"):
            got = getattr(self, name).shape[:2]
            require(got == shape, f"episodes' {name}", f"{shape} episodes and steps", got)

    @property
    def horizon(self) -> int:
        """Number of steps H."""
        return int(self.rewards.shape[1])

    def returns(self, discount: float) -> Array:
        r"""Return the discounted return :math:`R(\xi) = \sum_t \gamma^t r_t` of each episode, shape (N,)."""
        return np.asarray(self.rewards @ discount ** np.arange(self.horizon))

    def rewards_to_go(self, discount: float) -> Array:
        r"""Return :math:`\sum_{k \ge t} \gamma^{k-t} r_k` at each step, shape (N, H)."""
        result = np.empty_like(self.rewards)
        following = np.zeros(len(self.rewards))
        for t in reversed(range(self.horizon)):
            following = self.rewards[:, t] + discount * following
            result[:, t] = following
        return result

    def flat(self, values: Array) -> Array:
        """Return the entries of an array of shape (N, H, ...) where episodes went on, shape (samples, ...)."""
        return values[self.mask]

    @property
    def steps(self) -> NDArray[np.int_]:
        """The step t of each sample, shape (samples,)."""
        return np.broadcast_to(np.arange(self.horizon), self.mask.shape)[self.mask]
