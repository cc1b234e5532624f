"""How the episodes of a batch are shared among simulators of different speed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

ALIKE = 2.0  # times as long as the quickest, within which simulators count as equally quick
FIRST_PATIENCE, MOST_PATIENCE = 10, 160  # batches without episodes for a simulator, after which it is tried again


@dataclass
class Pace:
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


def share(episodes: int, rooms: Sequence[int], paces: Sequence[float]) -> list[int]:
    """Return how many episodes each simulator is to make side by side, so that all have ended soonest.

    Where there is not room for all, fewer are shared, and simulators that the others would wait for get none.

    Args:
        episodes: number of all.
        rooms: of the simulators, how many each has room for, at least 1.
        paces: of the simulators, seconds for an episode; 0 where it is not known.
    """
    known = _evened(paces)
    order = sorted(range(len(rooms)), key=known.__getitem__)  # the quickest first; in their order where alike
    shares = [_side_by_side(episodes, rooms, known, order[:count]) for count in range(1, len(rooms) + 1)]
    return min(reversed(shares), key=lambda counts: _seconds(counts, known) / sum(counts))


def _evened(paces: Sequence[float]) -> list[float]:
    """Return the paces, all the same where they are nearly; one that is not known is as the quickest."""
    quickest = min((pace for pace in paces if pace > 0), default=1.0)
    return [quickest if pace <= ALIKE * quickest else pace for pace in paces]


def _side_by_side(episodes: int, rooms: Sequence[int], paces: Sequence[float], chosen: Sequence[int]) -> list[int]:
    """Share as many as there is room for among those chosen, each to who would have made it first."""
    counts = [0] * len(rooms)
    for _ in range(min(episodes, sum(rooms[i] for i in chosen))):
        free = [i for i in chosen if counts[i] < rooms[i]]
        counts[min(free, key=lambda i: (counts[i] + 1) * paces[i])] += 1
    return counts


def _seconds(counts: Sequence[int], paces: Sequence[float]) -> float:
    return max(count * pace for count, pace in zip(counts, paces, strict=True))
