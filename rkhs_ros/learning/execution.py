"""How an episode went on a robot, and who is told of each episode as it ends."""

from __future__ import annotations

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
    """How one episode of k steps went on a robot, by the wall clock.

    Attributes:
        stamps: when each observation was taken, in nanoseconds since 1970, shape (k + 1,).
        executed: what was commanded after all limits, in the units of the robot's commands, shape (k, m).
        flags: what the gate changed and what was late at each step, sums of powers of two, shape (k,).
        discard_reason: why the episode is not to be learnt from; empty where it counts.
    """

    stamps: NDArray[np.int64]
    executed: Array
    flags: NDArray[np.uint32]
    discard_reason: str = ""

    def __post_init__(self) -> None:
        """Raise ValueError where the shapes do not fit."""
        steps = len(self.flags)
        require(
            len(self.stamps) == steps + 1, "execution's stamps", f"{steps + 1}, one more than steps", len(self.stamps)
        )
        require(len(self.executed) == steps, "executed commands", f"{steps}, one for each step", len(self.executed))


Record = Callable[[Batch, Episodes, list[Execution]], None]


def record_kinds(record: Record, batch: Batch, episodes: Episodes, executions: list[Execution]) -> None:
    """Record a batch, evaluation episodes first: exploring ones beside them ran ahead, and are of use after them."""
    for kind, rows in reversed(batch.kinds):
        record(kind, episodes.take(rows), executions[rows])


def discard(batch: Batch, episodes: Episodes, executions: list[Execution]) -> None:
    """Record nothing: what runners do with ended episodes unless told otherwise.

    Args:
        batch: the episodes' numbers.
        episodes: that ended, finished or discarded.
        executions: of each episode; none in a simulation.
    """
