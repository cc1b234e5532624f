"""Random streams that depend only on (seed, name, episode).

The draws of an episode are therefore the same on every machine and in every batch. Filters make noise of them.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from hashlib import blake2b
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from rkhs_ros.base.validation import require
from rkhs_ros.rkhs.kernels import Array


def stream_seed(seed: int, name: str, episode: int) -> int:
    """Return the 63-bit seed of a stream, a hash of its arguments."""
    digest = blake2b(f"{seed}/{name}/{episode}".encode(), digest_size=8).digest()
    return int.from_bytes(digest, "little") >> 1


def stream(seed: int, name: str, episode: int) -> np.random.Generator:
    """Return the counter-based random generator (Philox) of a stream."""
    return np.random.Generator(np.random.Philox(key=stream_seed(seed, name, episode)))


MAX_BATCH_SAMPLES = 10**7  # limits the memory that a message can request


@dataclass(frozen=True)
class Batch:
    """A batch of episodes that run in parallel, one per environment.

    Attributes:
        seed: seed of the run.
        first_episode: number of the first episode; environment i runs episode ``first_episode + i``.
        num_envs: number of environments and thus of episodes.
        horizon: maximum number of steps per episode.
        explore: whether actions are sampled from the policy; otherwise they are its mean. Exploring and evaluation
            episodes of the same number have different streams.
    """

    seed: int
    first_episode: int
    num_envs: int
    horizon: int
    explore: bool

    def __post_init__(self) -> None:
        """Raise ValueError if a number is out of range."""
        require(0 <= self.seed < 2**64, "seed", "a number in [0, 2^64)", self.seed)
        require(0 <= self.first_episode < 2**63, "first_episode", "a number in [0, 2^63)", self.first_episode)
        require(1 <= self.num_envs <= 10_000, "num_envs", "1 to 10000 episodes", self.num_envs)
        require(1 <= self.horizon <= 1_000_000, "horizon", "1 to 1000000 steps", self.horizon)
        samples = self.num_envs * self.horizon
        require(samples <= MAX_BATCH_SAMPLES, "num_envs and horizon", f"at most {MAX_BATCH_SAMPLES} samples", samples)

    @property
    def episodes(self) -> list[int]:
        """Episode number of each environment."""
        return list(range(self.first_episode, self.first_episode + self.num_envs))

    def part(self, begin: int, end: int) -> Batch:
        """Return a batch with the episodes of environments ``begin`` to ``end - 1``, where ``begin < end``."""
        return replace(self, first_episode=self.first_episode + begin, num_envs=end - begin)

    def parts(self, num_envs: int) -> list[Batch]:
        """Split the batch in order into batches of similar size, of at most ``num_envs`` environments."""
        count = -(-self.num_envs // num_envs)
        return [self.part(*ends) for ends in pairwise(self.num_envs * part // count for part in range(count + 1))]

    def environment_seeds(self) -> list[int]:
        """Return the seed of each environment."""
        kind = "training" if self.explore else "evaluation"
        return [stream_seed(self.seed, f"{kind}/environment", number) for number in self.episodes]

    def exploration(self, action_dim: int, decisions: int | None = None) -> NDArray[np.float64]:
        """Return the standard normal draws of exploration episodes, shape (num_envs, decisions, action_dim).

        Args:
            action_dim: dimension n of an action.
            decisions: number of decisions of an episode; None for one per step.
        """
        draws = np.empty((self.num_envs, self.horizon if decisions is None else decisions, action_dim))
        for row, number in enumerate(self.episodes):
            stream(self.seed, "training/exploration", number).standard_normal(out=draws[row])
        return draws


TAPS = 1000  # length of the filter in steps; over longer times the noise is white


def pink(white: Array) -> Array:
    r"""Filter white noise, shape (num_envs, horizon, n), to pink noise, whose power is proportional to 1 / frequency.

    .. math::
        y_t = \frac{\sum_{k=0}^{t} h_k x_{t-k}}{\sqrt{\sum_{k=0}^{t} h_k^2}}, \qquad
        h_0 = 1, \quad h_k = h_{k-1} \frac{k - 1/2}{k}

    with :math:`h_k = 0` from ``TAPS`` on. Each :math:`y_t` is N(0, 1) and depends on no later draw.

    The filter: Kasdin 1995, "Discrete simulation of colored noise and stochastic processes and 1/f power law noise
    generation", Proceedings of the IEEE 83(5). Its use: Eberhard et al. 2023, "Pink noise is all you need: colored
    noise exploration in deep reinforcement learning".
    """
    rows, horizon, dimensions = white.shape
    k = np.arange(1, min(horizon, TAPS))
    response = np.cumprod(np.concatenate([[1.0], (k - 0.5) / k]))  # h
    size = 1 << (horizon + len(response) - 2).bit_length()  # long enough that the end does not wrap around
    transfer = np.fft.rfft(response, size)
    sd = np.sqrt(np.cumsum(response**2))[np.minimum(np.arange(horizon), TAPS - 1)]
    noise = np.empty_like(white)
    for row in range(rows):
        for j in range(dimensions):  # one series at a time saves memory and keeps each series bit-identical
            noise[row, :, j] = np.fft.irfft(transfer * np.fft.rfft(white[row, :, j], size), size)[:horizon] / sd
    return noise


# Filters of exploration noise by name; each maps standard normal draws of shape (num_envs, horizon, n) to noise.
FILTERS: dict[str, Callable[[Array], Array]] = {"white": lambda white: white, "pink": pink}
