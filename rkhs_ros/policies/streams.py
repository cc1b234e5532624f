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
        num_envs: number of episodes.
        horizon: steps of an episode.
        explore: actions are drawn from the policy; otherwise they are its mean. Exploring and noise-free
            episodes of the same number have different streams.
        num_evaluation: how many of the rows, the last ones, hold evaluation episodes beside exploring ones.
        first_evaluation: number of the first of these; 0 where there are none.
    """

    seed: int
    first_episode: int
    num_envs: int
    horizon: int
    explore: bool
    num_evaluation: int = 0
    first_evaluation: int = 0

    def __post_init__(self) -> None:
        """Raise ValueError where a number is out of range."""
        require(0 <= self.seed < 2**64, "seed", "a number in [0, 2^64)", self.seed)
        require(0 <= self.first_episode < 2**63, "first_episode", "a number in [0, 2^63)", self.first_episode)
        require(1 <= self.num_envs <= 10_000, "num_envs", "1 to 10000 episodes", self.num_envs)
        require(1 <= self.horizon <= 1_000_000, "horizon", "1 to 1000000 steps", self.horizon)
        samples = self.num_envs * self.horizon
        require(
            samples <= MAX_BATCH_SAMPLES, "num_envs and horizon", f"at most {MAX_BATCH_SAMPLES} samples in all", samples
        )
        most = self.num_envs - 1 if self.explore else 0
        require(0 <= self.num_evaluation <= most, "num_evaluation", f"at most {most} rows", self.num_evaluation)
        last = 2**63 - 1 if self.num_evaluation else 0
        require(0 <= self.first_evaluation <= last, "first_evaluation", f"0 to {last}", self.first_evaluation)

    @property
    def keys(self) -> list[tuple[bool, int]]:
        """Whether the episode of each row explores, and its number among those of its kind."""
        numbers = range(self.first_episode, self.first_episode + self.num_envs - self.num_evaluation)
        beside = range(self.first_evaluation, self.first_evaluation + self.num_evaluation)
        return [(self.explore, number) for number in numbers] + [(False, number) for number in beside]

    @property
    def episodes(self) -> list[int]:
        """The episodes' numbers."""
        return [number for _, number in self.keys]

    @property
    def kinds(self) -> list[tuple[Batch, slice]]:
        """The exploring episodes and the noise-free ones as a batch each, where there are any, and their rows."""
        ends = [0, self.num_envs - self.num_evaluation, self.num_envs]
        return [(self.part(begin, end), slice(begin, end)) for begin, end in pairwise(ends) if end > begin]

    def beside(self, num_evaluation: Batch) -> Batch:
        """Return these exploring episodes and, in rows after them, noise-free ones of the same run.

        Raises:
            ValueError: they are too many for a batch.
        """
        rows, first = num_evaluation.num_envs, num_evaluation.first_episode
        return replace(self, num_envs=self.num_envs + rows, num_evaluation=rows, first_evaluation=first)

    def part(self, begin: int, end: int) -> Batch:
        """Return the episodes of the rows from ``begin`` to before ``end``, at least one, as a batch."""
        first_kind = self.num_envs - self.num_evaluation
        if begin >= first_kind:
            first = self.first_evaluation + begin - first_kind
            return Batch(self.seed, first, end - begin, self.horizon, explore=False)
        beside = max(end - first_kind, 0)
        return replace(
            self,
            first_episode=self.first_episode + begin,
            num_envs=end - begin,
            num_evaluation=beside,
            first_evaluation=self.first_evaluation if beside else 0,
        )

    def split(self, parts: int) -> list[Batch]:
        """Return the same episodes as that many batches of near the same size, in order; fewer where rows are few."""
        ends = [self.num_envs * part // parts for part in range(parts + 1)]
        return [self.part(begin, end) for begin, end in pairwise(ends) if end > begin]

    def shared(self, counts: Sequence[int]) -> list[Batch]:
        """Return the same episodes as batches of so many rows, each at least one, in order."""
        return [self.part(end - count, end) for count, end in zip(counts, accumulate(counts), strict=True)]

    def parts(self, rows: int) -> list[Batch]:
        """Return the same episodes as batches of at most that many rows, in order."""
        return self.split(-(-self.num_envs // rows))

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
