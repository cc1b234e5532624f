"""Random streams that depend on (seed, name, episode) and on nothing else.

So the draws of an episode are the same wherever and beside whatever other episodes it runs.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from hashlib import blake2b
from itertools import pairwise

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
    """

    seed: int
    first_episode: int
    rows: int
    horizon: int
    explore: bool

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

    @property
    def episodes(self) -> range:
        """The episodes' numbers."""
        return range(self.first_episode, self.first_episode + self.rows)

    def split(self, parts: int) -> list[Batch]:
        """Return the same episodes as that many batches of near the same size, in order; fewer where rows are few."""
        ends = [self.rows * part // parts for part in range(parts + 1)]
        shares = ((a, b - a) for a, b in pairwise(ends) if b > a)
        return [replace(self, first_episode=self.first_episode + a, rows=rows) for a, rows in shares]

    def parts(self, rows: int) -> list[Batch]:
        """Return the same episodes as batches of at most that many rows, in order."""
        return self.split(-(-self.rows // rows))

    def environment_seeds(self) -> list[int]:
        """Return a seed for the environment of each row."""
        return [stream_seed(self.seed, self._name("environment"), episode) for episode in self.episodes]

    def exploration(self, action_dim: int) -> NDArray[np.float64]:
        """Return the standard normal draws of all steps, shape (rows, horizon, action_dim)."""
        shape = (self.horizon, action_dim)
        name = self._name("exploration")
        return np.stack([stream(self.seed, name, episode).standard_normal(shape) for episode in self.episodes])

    def _name(self, of: str) -> str:
        return f"{'training' if self.explore else 'evaluation'}/{of}"
