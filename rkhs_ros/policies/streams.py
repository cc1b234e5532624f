"""Random streams that depend on (seed, name, episode) and on nothing else.

So the draws of an episode are the same wherever and beside whatever other episodes it runs.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from hashlib import blake2b
from itertools import accumulate, pairwise

import numpy as np
from numpy.typing import NDArray

from rkhs_ros.base.validation import require


def stream_seed(seed: int, name: str, episode: int) -> int:
    """Return the 63-bit seed of a stream, a hash of what it depends on."""
    digest = blake2b(f"{seed}/{name}/{episode}".encode(), digest_size=8).digest()
    return int.from_bytes(digest, "little") >> 1


def stream(seed: int, name: str, episode: int) -> np.random.Generator:
    """Return the stream's generator, counter-based (Philox)."""
    return np.random.Generator(np.random.Philox(key=stream_seed(seed, name, episode)))


MAX_BATCH_SAMPLES = 10**7  # so that no message can ask for more memory than there is


@dataclass(frozen=True)
class Batch:
    """The episodes that run side by side: what everyone needs to know of them when they start.

    Attributes:
        seed: seed of the run.
        first_episode: number of the episode in row 0; row i holds episode ``first_episode + i``.
        rows: number of episodes.
        horizon: steps of an episode.
        explore: actions are drawn from the policy; otherwise they are its mean. Exploring and noise-free
            episodes of the same number have different streams.
        noise_free: how many of the rows, the last ones, hold noise-free episodes beside exploring ones.
        first_noise_free: number of the first of these; 0 where there are none.
    """

    seed: int
    first_episode: int
    rows: int
    horizon: int
    explore: bool
    noise_free: int = 0
    first_noise_free: int = 0

    def __post_init__(self) -> None:
        """Raise ValueError where a number is out of range."""
        require(0 <= self.seed < 2**64, "seed", "a number in [0, 2^64)", self.seed)
        require(0 <= self.first_episode < 2**63, "first_episode", "a number in [0, 2^63)", self.first_episode)
        require(1 <= self.rows <= 10_000, "rows", "1 to 10000 episodes", self.rows)
        require(1 <= self.horizon <= 1_000_000, "horizon", "1 to 1000000 steps", self.horizon)
        samples = self.rows * self.horizon
        require(
            samples <= MAX_BATCH_SAMPLES, "rows and horizon", f"at most {MAX_BATCH_SAMPLES} samples in all", samples
        )
        most = self.rows - 1 if self.explore else 0
        require(0 <= self.noise_free <= most, "noise_free", f"at most {most} rows", self.noise_free)
        last = 2**63 - 1 if self.noise_free else 0
        require(0 <= self.first_noise_free <= last, "first_noise_free", f"0 to {last}", self.first_noise_free)

    @property
    def keys(self) -> list[tuple[bool, int]]:
        """Whether the episode of each row explores, and its number among those of its kind."""
        numbers = range(self.first_episode, self.first_episode + self.rows - self.noise_free)
        beside = range(self.first_noise_free, self.first_noise_free + self.noise_free)
        return [(self.explore, number) for number in numbers] + [(False, number) for number in beside]

    @property
    def episodes(self) -> list[int]:
        """The episodes' numbers."""
        return [number for _, number in self.keys]

    @property
    def kinds(self) -> list[tuple[Batch, slice]]:
        """The exploring episodes and the noise-free ones as a batch each, where there are any, and their rows."""
        ends = [0, self.rows - self.noise_free, self.rows]
        return [(self.part(begin, end), slice(begin, end)) for begin, end in pairwise(ends) if end > begin]

    def beside(self, noise_free: Batch) -> Batch:
        """Return these exploring episodes and, in rows after them, noise-free ones of the same run.

        Raises:
            ValueError: they are too many for a batch.
        """
        rows, first = noise_free.rows, noise_free.first_episode
        return replace(self, rows=self.rows + rows, noise_free=rows, first_noise_free=first)

    def part(self, begin: int, end: int) -> Batch:
        """Return the episodes of the rows from ``begin`` to before ``end``, at least one, as a batch."""
        first_kind = self.rows - self.noise_free
        if begin >= first_kind:
            first = self.first_noise_free + begin - first_kind
            return Batch(self.seed, first, end - begin, self.horizon, explore=False)
        beside = max(end - first_kind, 0)
        return replace(
            self,
            first_episode=self.first_episode + begin,
            rows=end - begin,
            noise_free=beside,
            first_noise_free=self.first_noise_free if beside else 0,
        )

    def split(self, parts: int) -> list[Batch]:
        """Return the same episodes as that many batches of near the same size, in order; fewer where rows are few."""
        ends = [self.rows * part // parts for part in range(parts + 1)]
        return [self.part(begin, end) for begin, end in pairwise(ends) if end > begin]

    def shared(self, counts: Sequence[int]) -> list[Batch]:
        """Return the same episodes as batches of so many rows, each at least one, in order."""
        return [self.part(end - count, end) for count, end in zip(counts, accumulate(counts), strict=True)]

    def parts(self, rows: int) -> list[Batch]:
        """Return the same episodes as batches of at most that many rows, in order."""
        return self.split(-(-self.rows // rows))

    def environment_seeds(self) -> list[int]:
        """Return a seed for the environment of each row."""
        return [stream_seed(self.seed, _name("environment", explore), number) for explore, number in self.keys]

    def exploration(self, action_dim: int) -> NDArray[np.float64]:
        """Return the standard normal draws of all steps of the rows that explore, shape (rows, horizon, action_dim)."""
        numbers = [number for explore, number in self.keys if explore]
        draws = np.empty((len(numbers), self.horizon, action_dim))
        for row, number in enumerate(numbers):
            stream(self.seed, _name("exploration", True), number).standard_normal(out=draws[row])
        return draws


def _name(of: str, explore: bool) -> str:
    return f"{'training' if explore else 'evaluation'}/{of}"
