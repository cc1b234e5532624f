"""Read a run from a bag that ``ros2 bag record`` wrote: its episodes and their returns."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

from rkhs_ros.base.validation import require
from rkhs_ros.learning.episodes import Episodes
from rkhs_ros.policies.spaces import Spaces
from rkhs_ros.policies.storage import Task
from rkhs_ros.recordings.batches import RecordedBatch
from rkhs_ros.recordings.recording import read_recording
from rkhs_ros.runs.curve import BEGINNING, NAN, Row
from rkhs_ros.view.recorded import both_kinds
from rkhs_ros.view.source import IterationView

UNDISCOUNTED = 1.0  # a bag does not contain the discount


class Bag:
    """A run in a bag.

    An iteration consists of the exploration episodes of one policy and the evaluation episodes after them.
    The whole bag is read once; a bag does not grow.

    Args:
        path: folder of a bag, or an MCAP file.

    Raises:
        ValueError: the bag contains no complete episodes.
        OSError: the bag cannot be read.
    """

    def __init__(self, path: Path) -> None:
        recording = read_recording(path)
        batches = recording.finished
        require(bool(batches), f"{path}", "a bag with complete episodes of a run", "none")
        self.path, self.name = path, path.stem
        self.task = Task("", {}, batches[0].batch.horizon, UNDISCOUNTED)
        self.nodes: Mapping[str, Mapping[str, Any]] = {}
        self.spaces: Spaces | None = None
        self._policies = recording.policies
        self._parts = list(_iterations(batches))
        self.rows: Sequence[Row] = list(_rows(self._parts))
        self.total = len(self._parts)

    @property
    def iterations(self) -> Sequence[int]:
        """All iterations."""
        return range(1, self.total + 1)

    def refresh(self) -> None:
        """Do nothing: a bag does not change."""

    def load(self, iteration: int) -> IterationView | None:
        """Return the episodes of an iteration, and the policy after it if the bag contains it."""
        part = self._parts[iteration - 1]
        version = next((each.version for each in part if not each.batch.explore), part[0].version)
        return IterationView(self._policies.get(version), *both_kinds(part))


def _iterations(batches: Sequence[RecordedBatch]) -> Iterator[list[RecordedBatch]]:
    """Yield the batches of each iteration. An iteration starts when a new policy explores."""
    part = [batches[0]]
    for last, batch in pairwise(batches):
        if batch.batch.explore and (not last.batch.explore or last.version != batch.version):
            yield part
            part = []
        part.append(batch)
    yield part


def _rows(parts: Sequence[list[RecordedBatch]]) -> Iterator[Row]:
    """Yield the row of the learning curve for each iteration; values that the bag lacks are NaN."""
    row, start = BEGINNING, parts[0][0].time
    for part in parts:
        exploration, evaluation = both_kinds(part)
        row = row._replace(
            iteration=row.iteration + 1,
            episodes=row.episodes + len(exploration or ()),
            steps=row.steps + (exploration.count if exploration else 0),
            evaluation_episodes=row.evaluation_episodes + len(evaluation or ()),
            exploration_return=_mean_return(exploration),
            evaluation_return=_mean_return(evaluation),
            seconds=(part[-1].time - start) / 1e9,
        )
        yield row


def _mean_return(episodes: Episodes | None) -> float:
    return NAN if episodes is None else float(episodes.returns(UNDISCOUNTED).mean())
