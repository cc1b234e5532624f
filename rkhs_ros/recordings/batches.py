"""Recorded batches of episodes, and the rule that selects the completed episodes."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import fields
from typing import NamedTuple

from rkhs_ros.learning.episodes import Episodes, Execution
from rkhs_ros.policies.streams import Batch

ARRAYS = [f.name for f in fields(Episodes)]


class RecordedBatch(NamedTuple):
    """Recorded batch of episodes.

    Attributes:
        batch: numbers of the episodes.
        version: version of the policy that acted.
        episodes: observations, actions and rewards.
        executions: executions of the episodes on a robot; empty for a simulation.
        time: time of the recording in nanoseconds since 1970.
    """

    batch: Batch
    version: int
    episodes: Episodes
    executions: list[Execution]
    time: int

    @property
    def is_discarded(self) -> bool:
        """Whether the batch was discarded, so that it is not used for training."""
        return any(execution.discard_reason for execution in self.executions)

    @property
    def attempt(self) -> tuple[Batch, tuple[bytes, ...]]:
        """Key of this attempt at the episodes: their numbers and the time stamps of a robot."""
        return self.batch, tuple(execution.stamps.tobytes() for execution in self.executions)

    def single_episodes(self) -> list[RecordedBatch]:
        """Return each episode as a separate batch."""
        singles = [slice(i, i + 1) for i in range(self.batch.num_envs)]
        return [
            self._replace(batch=batch, episodes=self.episodes.take(single), executions=self.executions[single])
            for batch, single in zip(self.batch.parts(1), singles, strict=True)
        ]


def countable(batches: Iterable[RecordedBatch]) -> dict[Batch, RecordedBatch]:
    """Return the completed episodes by number, sorted by time: the last finished, not discarded attempt at each.

    A veto may discard an attempt after it finished. The recording then contains the attempt twice with equal time
    stamps, and the attempt is omitted, whichever of the two is read first.
    """
    episodes = [episode for batch in batches for episode in batch.single_episodes()]
    discarded = {episode.attempt for episode in episodes if episode.is_discarded}
    finished = sorted((each for each in episodes if each.attempt not in discarded), key=lambda each: each.time)
    return {each.batch: each for each in finished}
