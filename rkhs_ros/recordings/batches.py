"""Recorded batches of episodes, and the one rule that says which of them count."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import fields
from typing import NamedTuple

from rkhs_ros.learning.episodes import Episodes
from rkhs_ros.learning.execution import Execution
from rkhs_ros.policies.streams import Batch

ARRAYS = [f.name for f in fields(Episodes)]


class RecordedBatch(NamedTuple):
    """A batch of episodes that ended.

    Attributes:
        batch: their numbers.
        version: of the policy that acted.
        episodes: what was observed, done and earned.
        executions: how they went on a robot; none of a simulation.
        time: when it was recorded, in nanoseconds since 1970.
    """

    batch: Batch
    version: int
    episodes: Episodes
    executions: list[Execution]
    time: int

    @property
    def is_discarded(self) -> bool:
        """Whether it is not to be learnt from."""
        return any(execution.discard_reason for execution in self.executions)

    @property
    def attempt(self) -> tuple[Batch, tuple[bytes, ...]]:
        """What tells this attempt at the episodes from others: their numbers and a robot's time stamps."""
        return self.batch, tuple(execution.stamps.tobytes() for execution in self.executions)

    def single_episodes(self) -> list[RecordedBatch]:
        """Return each episode as a batch of its own."""
        rows = [slice(row, row + 1) for row in range(self.batch.num_envs)]
        return [
            self._replace(batch=batch, episodes=self.episodes.take(row), executions=self.executions[row])
            for batch, row in zip(self.batch.parts(1), rows, strict=True)
        ]

    def has_same_episodes(self, other: RecordedBatch) -> bool:
        """Return whether the episodes of another batch are bit-identical."""
        return all(getattr(self.episodes, name).tobytes() == getattr(other.episodes, name).tobytes() for name in ARRAYS)


def finished_episodes(batches: Iterable[RecordedBatch]) -> list[RecordedBatch]:
    """Return the attempts at single episodes that were finished and not discarded, in the order of their times.

    An attempt that was finished may be discarded later, by a veto. It is recorded twice then, with the same time
    stamps, and does not count, in whichever order the two are read.
    """
    episodes = [episode for batch in batches for episode in batch.single_episodes()]
    discarded = {episode.attempt for episode in episodes if episode.is_discarded}
    return sorted((each for each in episodes if each.attempt not in discarded), key=lambda each: each.time)


def countable(batches: Iterable[RecordedBatch]) -> dict[Batch, RecordedBatch]:
    """Return the episodes that count by their numbers; of several finished attempts at one the last counts."""
    return {each.batch: each for each in finished_episodes(batches)}
