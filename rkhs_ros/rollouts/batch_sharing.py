"""Distribution of the episodes of a batch among simulators of different throughput."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

ALIKE = 2.0  # simulators that take at most this multiple of the fastest one's time count as equally fast
FIRST_PATIENCE, MOST_PATIENCE = 10, 160  # batches without episodes until a slow simulator is tried again


@dataclass
class EpisodeTiming:
    """Last measured episode time of a simulator.

    Attributes:
        seconds: time per episode; 0 if unknown.
        waits: number of batches since the last measurement, none of which used this simulator.
        patience: number of such batches after which the time is discarded; doubles each time.
    """

    seconds: float = 0.0
    waits: int = 0
    patience: int = FIRST_PATIENCE

    @property
    def is_new(self) -> bool:
        """Whether the simulator took part in every batch so far."""
        return (self.waits, self.patience) == (0, FIRST_PATIENCE)

    def took(self, seconds: float, episodes: int) -> None:
        """Store the time for a number of episodes."""
        self.seconds, self.waits = seconds / episodes, 0

    def left_out(self) -> None:
        """Count a batch without this simulator; discard its time when the patience ends."""
        self.waits += 1
        if self.waits >= self.patience:
            self.seconds, self.waits, self.patience = 0.0, 0, min(2 * self.patience, MOST_PATIENCE)


def share(episodes: int, capacities: Sequence[int], seconds: Sequence[float]) -> list[int]:
    """Return the number of parallel episodes for each simulator that maximises the throughput.

    If the capacity is too small for all episodes, the result contains fewer. A simulator that would delay the others
    gets no episodes.

    Args:
        episodes: total number of episodes.
        capacities: maximum number of parallel episodes of each simulator, at least 1.
        seconds: time per episode of each simulator; 0 if unknown.
    """
    known = _evened(seconds)
    order = sorted(range(len(capacities)), key=known.__getitem__)  # fastest first; stable for equal times
    shares = [_assigned(episodes, capacities, known, order[:count]) for count in range(1, len(capacities) + 1)]
    return min(reversed(shares), key=lambda counts: _seconds(counts, known) / sum(counts))


def _evened(seconds: Sequence[float]) -> list[float]:
    """Return the times, with unknown times and those close to the fastest one set to the fastest one."""
    quickest = min((each for each in seconds if each > 0), default=1.0)
    return [quickest if each <= ALIKE * quickest else each for each in seconds]


def _assigned(episodes: int, capacities: Sequence[int], seconds: Sequence[float], chosen: Sequence[int]) -> list[int]:
    """Assign episodes greedily to the chosen simulator that would finish first, up to the capacity."""
    counts = [0] * len(capacities)
    for _ in range(min(episodes, sum(capacities[i] for i in chosen))):
        free = [i for i in chosen if counts[i] < capacities[i]]
        counts[min(free, key=lambda i: (counts[i] + 1) * seconds[i])] += 1
    return counts


def _seconds(counts: Sequence[int], seconds: Sequence[float]) -> float:
    return max(count * each for count, each in zip(counts, seconds, strict=True))
