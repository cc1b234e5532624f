"""Read a run from its recording: the policy and the episodes of every iteration, on demand."""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from functools import cache
from io import SEEK_SET
from pathlib import Path
from typing import Any, NamedTuple

from mcap.records import McapRecord
from mcap.writer import MCAP0_MAGIC

from rkhs_ros.base.files import is_locked
from rkhs_ros.base.validation import require
from rkhs_ros.base.yaml_text import loaded
from rkhs_ros.learning.episodes import Episodes
from rkhs_ros.learning.iteration import Row
from rkhs_ros.learning.model_based.training_in_model import model_rollouts_of
from rkhs_ros.learning.training_settings import ModelBased
from rkhs_ros.policies.gaussian import GaussianPolicy
from rkhs_ros.policies.messages import policy_of
from rkhs_ros.recordings.batches import RecordedBatch, countable
from rkhs_ros.recordings.container import Scan, Stored, records
from rkhs_ros.recordings.definitions import PACKAGE, decoded
from rkhs_ros.recordings.recording import Head, faults_named, head_of, recording_file, recording_of
from rkhs_ros.runs.config import load_config, robot_nodes
from rkhs_ros.runs.recorded import training_of
from rkhs_ros.runs.report import is_started

MODEL_ROLLOUTS = 3  # per iteration
RUNNING, FINISHED, ENDED = "running", "finished", "not running"


class IterationView(NamedTuple):
    """The policy and the episodes of an iteration.

    Attributes:
        policy: policy after the update.
        exploration: exploration episodes of the iteration, as observed; None if there are none.
        evaluation: evaluation episodes of the updated policy, as observed; None if there are none.
        roll_out_model: rolls the policy out, without exploration noise, in a model of all episodes so far; None for
            a run without a model.
    """

    policy: GaussianPolicy
    exploration: Episodes | None
    evaluation: Episodes | None
    roll_out_model: Callable[[], Episodes] | None = None


class Place(NamedTuple):
    """Position of a message.

    Attributes:
        offset: offset of its record in the file, in bytes.
        kind: name of its type within our package.
        time: time of the recording in nanoseconds since 1970.
    """

    offset: int
    kind: str
    time: int


class Following:
    """Reader of a recording that may grow; holds at most one message in memory.

    Owns the position in the file. Skips damaged records.

    Args:
        path: an MCAP file, which may not exist yet.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._begin(0)

    def news(self) -> tuple[bool, list[tuple[Place, Any]]]:
        """Return whether the file was replaced, and our messages since the last call."""
        try:
            about = self.path.stat()
        except OSError:
            return False, []
        is_other = about.st_ino != self._inode or about.st_size < self._offset
        if is_other:
            self._begin(about.st_ino)
        return is_other, list(self._read(about.st_size))

    def message(self, place: Place) -> Any:
        """Return the message at a place.

        Raises:
            ValueError: the message no longer exists.
        """
        with self.path.open("rb") as file:
            file.seek(place.offset, SEEK_SET)
            for _, record in records(file, self.path.stat().st_size):
                for stored, message in self._scanned(record):
                    if stored.kind == PACKAGE + place.kind and stored.time == place.time:
                        return message
                break
        raise ValueError(f"{self.path}: expected a message of type {place.kind} at {place.offset}, got another")

    def _begin(self, inode: int) -> None:
        self._inode = inode
        self._offset = len(MCAP0_MAGIC)
        self._scan = Scan()

    def _read(self, size: int) -> Iterator[tuple[Place, Any]]:
        with self.path.open("rb") as file:
            file.seek(self._offset)
            for begin, record in records(file, size):
                for stored, message in self._scanned(record):
                    yield Place(begin, stored.kind.removeprefix(PACKAGE), stored.time), message
                self._offset = file.tell()

    def _scanned(self, record: McapRecord) -> list[tuple[Stored, Any]]:
        """Return pairs of a stored and a deserialised message, for our messages in a record; none if it is damaged."""
        try:
            ours = [each for each in self._scan.messages(record) if each.kind.startswith(PACKAGE)]
            return [(each, decoded(each.content, each.kind, each.definition)) for each in ours]
        except Exception:  # a damaged record raises almost anything
            return []


class StoredIteration(NamedTuple):
    """The positions of an iteration's policy and episodes in the recording."""

    policy: Place
    episodes: tuple[Place, ...]


class Recorded:
    """A recorded run that may still grow.

    Owns the rows of the learning curve and the positions of policies and episodes in the file.

    Args:
        path: folder of a run, or an MCAP file.

    Attributes:
        path: folder or file of the run.
        name: name of the run.
        task: task of the run.
        nodes: parameters of a robot's nodes by node name; empty for a simulator.
        spaces: spaces of the task.
        total: planned number of iterations.

    Raises:
        ValueError: the file is no recording, or contains no run.
        OSError: the file does not exist.
    """

    def __init__(self, path: Path) -> None:
        file = recording_file(path)
        self.path = file.parent if is_started(file.parent) else file
        self._following = Following(file)
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
        roll_out_model = self._model_rollouts(policy, iteration)
        return IterationView(policy, *both_kinds(batches), roll_out_model)

    def _model_rollouts(self, policy: GaussianPolicy, iteration: int) -> Callable[[], Episodes] | None:
        """Return a cached function that rolls a policy out in the model; None without a model."""
        settings, spaces, discount = self._model_settings, self.spaces, self.task.discount
        if not isinstance(settings, ModelBased):
            return None
        explored = self._explored
        return cache(lambda: model_rollouts_of(settings, policy, explored(iteration), spaces, discount, MODEL_ROLLOUTS))

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


def state_of(run: Recorded) -> str:
    """Return the state of a run: RUNNING, FINISHED or ENDED (before its last iteration)."""
    if run.path.is_dir() and is_locked(run.path):
        return RUNNING
    done = run.rows[-1].iteration if run.rows else 0
    return FINISHED if done >= run.total else ENDED
