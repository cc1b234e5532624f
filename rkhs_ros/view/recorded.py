"""A run seen through its recording, whole: policy and episodes of each iteration, read when they are looked at."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from rkhs_ros.base.validation import require
from rkhs_ros.base.yaml_text import loaded
from rkhs_ros.learning.episodes import Episodes
from rkhs_ros.policies.messages import policy_of
from rkhs_ros.policies.spaces import Spaces
from rkhs_ros.recordings.batches import RecordedBatch, countable
from rkhs_ros.recordings.following import Following, Place
from rkhs_ros.recordings.recording import Head, faults_named, head_of, recording_file, recording_of
from rkhs_ros.runs.config import load_config, robot_nodes
from rkhs_ros.runs.curve import Row
from rkhs_ros.runs.recorded import training_of
from rkhs_ros.runs.report import is_begun
from rkhs_ros.view.source import IterationView, imagining


class StoredIteration(NamedTuple):
    """Where in the recording is what an iteration left."""

    policy: Place
    episodes: tuple[Place, ...]


class Recorded:
    """A run in its recording.

    Owns the lines of the learning curve, and where policies and episodes are.

    Args:
        path: the folder of a run, or an MCAP file.

    Raises:
        ValueError: it is no recording, or holds no run.
        OSError: there is none.
    """

    def __init__(self, path: Path) -> None:
        file = recording_file(path)
        self.path = file.parent if is_begun(file.parent) else file
        self._following = Following(file)
        self.spaces: Spaces | None = None
        self._forget()
        self.refresh()
        require(self._head is not None, f"{file}", "the recording of a run", "none of a run, or not begun yet")

    def refresh(self) -> None:
        """Read what was recorded since the last time."""
        is_other, news = self._following.news()
        if is_other:
            self._forget()
        with faults_named(self._following.path):
            for place, message in news:
                self._take(place, message)

    @property
    def rows(self) -> Sequence[Row]:
        """The lines of the learning curve so far."""
        return self._rows

    @property
    def iterations(self) -> Sequence[int]:
        """The iterations done."""
        return list(self._left)

    def seen(self, iteration: int) -> IterationView | None:
        """Return what an iteration left."""
        left = self._left.get(iteration)
        if left is None:
            return None
        try:
            with faults_named(self._following.path):
                policy = policy_of(self._following.message(left.policy))
                batches = [self._batch(place) for place in left.episodes]
        except (ValueError, OSError):  # the run goes on with another file, of which more is known in a moment
            return None
        imagine = imagining(self._model_settings, policy, lambda: self._explored(iteration), self.spaces)
        return IterationView(policy, *both_kinds(batches), imagine)

    def _explored(self, iteration: int) -> Episodes:
        """Return the exploring episodes of the iterations up to one."""
        places = [place for number, left in self._left.items() if number <= iteration for place in left.episodes]
        episodes, _ = both_kinds(map(self._batch, places))
        if episodes is None:
            raise ValueError("recording: expected exploring episodes, got none")
        return episodes

    def _forget(self) -> None:
        self._head: Head | None = None
        self._rows: list[Row] = []
        self._left: dict[int, StoredIteration] = {}
        self._policies: dict[int, Place] = {}
        self._episodes: list[tuple[int, Place]] = []  # that no update had yet, and the first exploring one's number

    def _take(self, place: Place, message: Any) -> None:
        if place.kind == "Task":
            if self._head is None:  # later ones tell of other versions
                self._begin(head_of(message), place)
        elif self._head is None:
            return  # it is no recording of a run, or its head is damaged
        elif place.kind == "Policy":
            self._policies[message.version] = place
        elif place.kind == "RecordedEpisodes":
            self._episodes.append((message.first_episode if message.explore else -1, place))
        elif place.kind == "Update" and message.policy_version in self._policies:
            self._rows.append(self._row(message, place))
            mine = [place for first, place in self._episodes if first < message.episodes]
            self._left[message.iteration] = StoredIteration(self._policies[message.policy_version], tuple(mine))
            self._episodes = [each for each in self._episodes if each[1] not in mine]  # which ran ahead

    def _begin(self, head: Head, place: Place) -> None:
        training = training_of(head)
        if self.path.is_dir():
            training = load_config(self.path / "config.yaml").training  # which may have been told to go on for longer
        self._head, self._began_ns, self._model_settings = head, place.time, training.model
        self.name, self.task, self.spaces, self.total = training.name, head.task, head.spaces, training.iterations
        self.nodes: Mapping[str, Mapping[str, Any]] = robot_nodes(loaded(head.configuration))

    def _row(self, update: Any, place: Place) -> Row:
        known = {name: getattr(update, name) for name in Row._fields if name != "seconds"}
        return Row(**known, seconds=(place.time - self._began_ns) / 1e9)

    def _batch(self, place: Place) -> RecordedBatch:
        return recording_of([(place.kind, place.time, self._following.message(place))]).batches[0]


def both_kinds(batches: Iterable[RecordedBatch]) -> tuple[Episodes | None, Episodes | None]:
    """Return the exploring and the evaluation episodes that count; None if there are none of a kind."""
    finished = countable(batches).values()
    kinds = ([each.episodes for each in finished if each.batch.explore == explore] for explore in (True, False))
    explored, evaluated = (Episodes.concatenate(kind) if kind else None for kind in kinds)
    return explored, evaluated
