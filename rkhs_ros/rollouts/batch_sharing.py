"""How the episodes of a batch are shared among simulators of different speed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

ALIKE = 2.0  # times as long as the quickest, within which simulators count as equally quick
FIRST_PATIENCE, MOST_PATIENCE = 10, 160  # batches without episodes for a simulator, after which it is tried again


@dataclass
class EpisodeTiming:
    """How quick a simulator was when it was asked last.

    Attributes:
        seconds: for each of its episodes; 0 where it is not known.
        waits: batches that went without it since.
        patience: batches that may, before what is known of it is forgotten; twice as many each time.
    """

    seconds: float = 0.0
    waits: int = 0
    patience: int = FIRST_PATIENCE

    @property
    def is_new(self) -> bool:
        """Whether no batch went without it yet."""
        return (self.waits, self.patience) == (0, FIRST_PATIENCE)

    def took(self, seconds: float, episodes: int) -> None:
        """Note how long it took for so many episodes."""
        self.seconds, self.waits = seconds / episodes, 0

    def left_out(self) -> None:
        """Note that a batch went without it; after a while what is known of it is forgotten."""
        self.waits += 1
        if self.waits >= self.patience:
            self.seconds, self.waits, self.patience = 0.0, 0, min(2 * self.patience, MOST_PATIENCE)


def share(episodes: int, capacities: Sequence[int], seconds: Sequence[float]) -> list[int]:
    """Return how many episodes each simulator is to make side by side, so that all have ended soonest.

    Where there is not room for all, fewer are shared, and simulators that the others would wait for get none.

    Args:
        episodes: number of all.
        capacities: of the simulators, how many each has room for, at least 1.
        seconds: of the simulators, seconds for an episode; 0 where it is not known.
    """
    known = _evened(seconds)
    order = sorted(range(len(capacities)), key=known.__getitem__)  # the quickest first; in their order where alike
    shares = [_side_by_side(episodes, capacities, known, order[:count]) for count in range(1, len(capacities) + 1)]
    return min(reversed(shares), key=lambda counts: _seconds(counts, known) / sum(counts))


def _evened(seconds: Sequence[float]) -> list[float]:
    """Return the seconds, all the same where they are nearly; one that is not known is as the quickest."""
    quickest = min((each for each in seconds if each > 0), default=1.0)
    return [quickest if each <= ALIKE * quickest else each for each in seconds]


def _side_by_side(
    episodes: int, capacities: Sequence[int], seconds: Sequence[float], chosen: Sequence[int]
) -> list[int]:
    """Share as many as there is room for among those chosen, each to who would have made it first."""
    counts = [0] * len(capacities)
    for _ in range(min(episodes, sum(capacities[i] for i in chosen))):
        free = [i for i in chosen if counts[i] < capacities[i]]
        counts[min(free, key=lambda i: (counts[i] + 1) * seconds[i])] += 1
    return counts


def _seconds(counts: Sequence[int], seconds: Sequence[float]) -> float:
    return max(count * each for count, each in zip(counts, seconds, strict=True))
