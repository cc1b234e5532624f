"""Execution logs of episodes on a robot, and the callback that records finished episodes."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rkhs_ros.base.validation import require
from rkhs_ros.learning.episodes import Episodes
from rkhs_ros.policies.streams import Batch
from rkhs_ros.rkhs.kernels import Array


@dataclass(frozen=True, eq=False)
class Execution:
    """The execution log of one episode of k steps on a robot.

    Attributes:
        stamps: wall-clock time of each observation, in nanoseconds since 1970, shape (k + 1,).
        executed: commands after all limits, in the units of the robot's commands, shape (k, m).
        flags: bit flags of the gate's changes and late messages at each step, shape (k,).
        discard_reason: why the episode is discarded; empty if learning uses it.
    """

    stamps: NDArray[np.int64]
    executed: Array
    flags: NDArray[np.uint32]
    discard_reason: str = ""

    def __post_init__(self) -> None:
        """Raise ValueError if the shapes do not match."""
        steps = len(self.flags)
        require(
            len(self.stamps) == steps + 1, "execution's stamps", f"{steps + 1}, one more than steps", len(self.stamps)
        )
        require(len(self.executed) == steps, "executed commands", f"{steps}, one per step", len(self.executed))


Record = Callable[[Batch, Episodes, list[Execution]], None]


def record_kinds(record: Record, batch: Batch, episodes: Episodes, executions: list[Execution]) -> None:
    """Record a batch, evaluation episodes first, because exploring ones that ran ahead are used after them."""
    for kind, rows in reversed(batch.kinds):
        record(kind, episodes.take(rows), executions[rows])


def discard(batch: Batch, episodes: Episodes, executions: list[Execution]) -> None:
    """Discard finished episodes; the default callback of runners.

    Args:
        batch: the batch with the episodes' numbers.
        episodes: finished episodes, including discarded ones.
        executions: execution log of each episode; empty for simulations.
    """
