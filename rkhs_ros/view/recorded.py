"""Read a run from its recording: the policy and the episodes of every iteration, on demand."""

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from rkhs_ros.base.validation import require
from rkhs_ros.base.yaml_text import loaded
from rkhs_ros.learning.episodes import Episodes
from rkhs_ros.learning.iteration import Row
from rkhs_ros.policies.messages import policy_of
from rkhs_ros.policies.spaces import Spaces
from rkhs_ros.recordings.batches import RecordedBatch, countable
from rkhs_ros.recordings.following import Following, Place
from rkhs_ros.recordings.recording import Head, faults_named, head_of, recording_file, recording_of
from rkhs_ros.runs.config import load_config, robot_nodes
from rkhs_ros.runs.recorded import training_of
from rkhs_ros.runs.report import is_started
from rkhs_ros.view.source import IterationView, model_rollout_function


class StoredIteration(NamedTuple):
    """The positions of an iteration's policy and episodes in the recording."""

    policy: Place
    episodes: tuple[Place, ...]


class Recorded:
    """A recorded run.

    Owns the rows of the learning curve and the positions of policies and episodes in the file.

    Args:
        path: folder of a run, or an MCAP file.

    Raises:
        ValueError: the file is no recording, or contains no run.
        OSError: the file does not exist.
    """

    def __init__(self, path: Path) -> None:
        file = recording_file(path)
        self.path = file.parent if is_started(file.parent) else file
        self._following = Following(file)
        self.spaces: Spaces | None = None
        self._reset()
        self.refresh()
        require(self._head is not None, f"{file}", "the recording of a run", "a file without the header of a run")

    def refresh(self) -> None:
        """Read the messages recorded since the last call."""
        is_other, news = self._following.news()
        if is_other:
            self._reset()
        with faults_named(self._following.path):
            for place, message in news:
                self._take(place, message)

    @property
    def rows(self) -> Sequence[Row]:
        """The rows of the learning curve so far."""
        return self._rows

    @property
    def iterations(self) -> Sequence[int]:
        """The completed iterations."""
        return list(self._stored)

    def load(self, iteration: int) -> IterationView | None:
        """Return the policy and the episodes of an iteration."""
        stored = self._stored.get(iteration)
        if stored is None:
            return None
        try:
            with faults_named(self._following.path):
                policy = policy_of(self._following.message(stored.policy))
                batches = [self._batch(place) for place in stored.episodes]
        except (ValueError, OSError):  # the run continues in another file, which the next refresh reads
            return None
        roll_out_model = model_rollout_function(
            self._model_settings, policy, lambda: self._explored(iteration), self.spaces, self.task.discount
        )
        return IterationView(policy, *both_kinds(batches), roll_out_model)

    def _explored(self, iteration: int) -> Episodes:
        """Return the exploration episodes of all iterations up to the given one."""
        places = [place for number, stored in self._stored.items() if number <= iteration for place in stored.episodes]
        episodes, _ = both_kinds(map(self._batch, places))
        if episodes is None:
            raise ValueError("recording: expected exploration episodes, got none")
        return episodes

    def _reset(self) -> None:
        self._head: Head | None = None
        self._rows: list[Row] = []
        self._stored: dict[int, StoredIteration] = {}
        self._policies: dict[int, Place] = {}
        self._episodes: list[tuple[int, Place]] = []  # not used by an update yet, with the first exploring number

    def _take(self, place: Place, message: Any) -> None:
        if place.kind == "Task":
            if self._head is None:  # later ones belong to other versions
                self._begin(head_of(message), place)
        elif self._head is None:
            return  # no recording of a run, or a damaged header
        elif place.kind == "Policy":
            self._policies[message.version] = place
        elif place.kind == "RecordedEpisodes":
            self._episodes.append((message.first_episode if message.explore else -1, place))
        elif place.kind == "Update" and message.policy_version in self._policies:
            self._rows.append(self._row(message, place))
            mine = [place for first, place in self._episodes if first < message.episodes]
            self._stored[message.iteration] = StoredIteration(self._policies[message.policy_version], tuple(mine))
            self._episodes = [each for each in self._episodes if each[1] not in mine]  # episodes that ran ahead

    def _begin(self, head: Head, place: Place) -> None:
        training = training_of(head)
        if self.path.is_dir():
            training = load_config(self.path / "config.yaml").training  # a resumed run may have more iterations
        self._head, self._began_ns, self._model_settings = head, place.time, training.model
        self.name, self.task, self.spaces, self.total = training.name, head.task, head.spaces, training.iterations
        self.nodes: Mapping[str, Mapping[str, Any]] = robot_nodes(loaded(head.configuration))

    def _row(self, update: Any, place: Place) -> Row:
        known = {name: getattr(update, name) for name in Row._fields if name != "seconds"}
        return Row(**known, seconds=(place.time - self._began_ns) / 1e9)

    def _batch(self, place: Place) -> RecordedBatch:
        return recording_of([(place.kind, place.time, self._following.message(place))]).batches[0]


def both_kinds(batches: Iterable[RecordedBatch]) -> tuple[Episodes | None, Episodes | None]:
    """Return the exploring and the evaluation episodes, without discarded ones; None for a kind without episodes."""
    finished = countable(batches).values()
    kinds = ([each.episodes for each in finished if each.batch.explore == explore] for explore in (True, False))
    explored, evaluated = (Episodes.concatenate(kind) if kind else None for kind in kinds)
    return explored, evaluated
