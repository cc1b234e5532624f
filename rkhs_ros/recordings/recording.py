"""What a recording holds, as values: what was learnt, each policy, each batch of episodes and each update."""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rkhs_ros.base.files import open_regular, read_whole, write_whole
from rkhs_ros.base.validation import require, truncated
from rkhs_ros.learning.episodes import Episodes
from rkhs_ros.learning.messages import episodes_of, executions_of
from rkhs_ros.policies.gaussian import GaussianPolicy
from rkhs_ros.policies.messages import policy_of, spaces_fields, spaces_of
from rkhs_ros.policies.spaces import Spaces
from rkhs_ros.policies.storage import Task
from rkhs_ros.policies.streams import Batch
from rkhs_ros.recordings.batches import RecordedBatch, countable, finished_episodes
from rkhs_ros.recordings.definitions import PACKAGE, decoded, store_of_all

if TYPE_CHECKING:
    from rkhs_ros.recordings.container import Found, Stored

FILE = "recording.mcap"
BAG = "metadata.yaml"  # in the folder of a bag


@dataclass(frozen=True)
class Head:
    """What a run learns and how, at the head of its recording.

    Attributes:
        task: what it learns.
        spaces: of the task.
        seed: of all randomness.
        configuration: all settings, as a ROS parameter file.
        versions: of code and libraries, "name version" each.
        warm_start: whether the first policy was given.
    """

    task: Task
    spaces: Spaces
    seed: int
    configuration: str
    versions: tuple[str, ...]
    warm_start: bool


@dataclass
class Recording:
    """What a recording holds.

    Attributes:
        heads: what was learnt and how; another one where the run went on with other versions, none in a bag that others
            recorded.
        policies: by version.
        batches: in the order in which they ended, discarded ones included.
        updates: the messages of the iterations done.
        lost: bytes of the file that are ignored because they are damaged or cut.
    """

    heads: list[Head] = field(default_factory=list)
    policies: dict[int, GaussianPolicy] = field(default_factory=dict)
    batches: list[RecordedBatch] = field(default_factory=list)
    updates: list[Any] = field(default_factory=list)
    lost: int = 0

    @property
    def head(self) -> Head | None:
        """The first head; None where there is none."""
        return self.heads[0] if self.heads else None

    @property
    def finished(self) -> list[RecordedBatch]:
        """The episodes that count, each once, as batches of one row."""
        return list(self.by_numbers().values())

    @property
    def replaced(self) -> int:
        """How many finished episodes do not count, as others of their numbers were recorded later."""
        finished = finished_episodes(self.batches)
        last = {each.batch: each for each in finished}
        return sum(not each.has_same_episodes(last[each.batch]) for each in finished)

    def episodes(self) -> Episodes:
        """Return all episodes that count, each once.

        Raises:
            ValueError: there are none, or of different horizons.
        """
        finished = self.finished
        horizons = {each.batch.horizon for each in finished}
        got = "none, as the file is damaged" if self.lost else "none"
        require(bool(finished), "recording", "at least one finished episode", got)
        require(len(horizons) == 1, "recording", "episodes of one horizon", f"horizons {sorted(horizons)}")
        return Episodes.concatenate(each.episodes for each in finished)

    def by_numbers(self) -> dict[Batch, RecordedBatch]:
        """Return the episodes that count by their numbers, a batch of one row each."""
        return countable(self.batches)


def head_fields(head: Head) -> dict[str, Any]:
    """Return the fields of the message at the head of a recording."""
    return {
        "environment": head.task.environment,
        "options": json.dumps(dict(head.task.options)),
        "horizon": head.task.horizon,
        "discount": head.task.discount,
        **spaces_fields(head.spaces),
        "seed": head.seed,
        "configuration": head.configuration,
        "versions": list(head.versions),
        "warm_start": head.warm_start,
    }


def head_of(message: Any) -> Head:
    """Return the head of a recording from its message.

    Raises:
        ValueError: it is none.
    """
    task = Task(message.environment, json.loads(message.options), message.horizon, message.discount)
    versions = tuple(message.versions)
    return Head(task, spaces_of(message), message.seed, message.configuration, versions, bool(message.warm_start))


def recording_file(path: Path) -> Path:
    """Return the recording of a run's folder; a file, and the folder of a bag, as they are.

    Raises:
        FileNotFoundError: there is none.
    """
    if not path.exists():
        raise FileNotFoundError(f"{path}: no such recording")
    if not path.is_dir() or (path / BAG).is_file():
        return path
    if not (path / FILE).is_file():
        raise FileNotFoundError(f"{path}: no {FILE} in it; runs are recorded by rkhs train --record")
    return path / FILE


def read_recording(path: Path) -> Recording:
    """Read a recording; what is damaged is passed over, with a line on standard error.

    Args:
        path: an MCAP file, the folder of a run that was recorded, or that of a bag.

    Raises:
        ValueError: it is none, or holds nothing of ours.
        OSError: it cannot be read.
    """
    path = recording_file(path)
    found = None if path.is_dir() else _whole(path)
    with faults_named(path):
        recording = recording_of(_ours(found.messages) if found else _bag_messages(path))
    recording.lost = found.lost if found else 0
    require(bool(recording.head or recording.batches), f"{path}", "a recording of a run", "none of our messages")
    if count := recording.replaced:
        print(
            f"warning: {path}: {count} episodes are ignored; later ones have the same seeds and numbers. "
            "Record runs with the same seed in separate bags.",
            file=sys.stderr,
        )
    return recording


def read_held(path: Path) -> tuple[Recording, list[Stored]]:
    """Return what a file holds of a run that goes on, and its messages; nothing where there is none, or no head.

    The run writes the file anew with these. So a file that holds more, which may yet be mended, is kept beside it.

    Raises:
        ValueError: it is no recording.
        OSError: it cannot be read, or not kept.
    """
    if not os.path.lexists(path):
        return Recording(), []
    found = _whole(path)
    with faults_named(path):
        recording = recording_of(_ours(found.messages))
    if found.lost or (found.messages and not recording.head):
        _keep_damaged(path)
    return (recording, found.messages) if recording.head else (Recording(), [])


@contextmanager
def faults_named(path: Path) -> Iterator[None]:
    """Name the recording whose messages are none of a run, as others may write them.

    Raises:
        ValueError: they raised anything.
    """
    try:
        yield
    except OSError:
        raise
    except Exception as error:
        why = str(error) if isinstance(error, ValueError) else f"{type(error).__name__}: {error}"
        if why.startswith(f"{path}"):
            raise
        raise ValueError(
            f"{path}: expected the messages of a run, got some that are none ({truncated(why)})"
        ) from error


def _keep_damaged(path: Path) -> None:
    count = len(list(path.parent.glob(f"{path.stem}_damaged_*{path.suffix}")))
    kept = path.with_name(f"{path.stem}_damaged_{count + 1}{path.suffix}")
    write_whole(kept, read_whole(path))
    print(f"warning: {path}: kept as it was in {kept}", file=sys.stderr)


def _whole(path: Path) -> Found:
    """Return the messages of an MCAP file that are whole; what is damaged is named on standard error."""
    from rkhs_ros.recordings.container import read_messages  # here, since only recordings need mcap

    found = read_messages(path)
    for fault in found.faults:
        print(f"warning: {path}: {fault}", file=sys.stderr)
    return found


def _ours(messages: Iterable[Stored]) -> Iterator[tuple[str, int, Any]]:
    """Yield type, time and message of those that are ours."""
    for stored in messages:
        if stored.kind.startswith(PACKAGE):
            yield stored.kind, stored.time, decoded(stored.content, stored.kind, stored.definition)


def _bag_messages(folder: Path) -> Iterator[tuple[str, int, Any]]:
    """Yield type, time and message of what a bag holds of ours."""
    files = sorted(folder.glob("*.mcap"))
    if files:  # by our own reader, within bounds
        yield from _ours(sorted((each for file in files for each in _whole(file).messages), key=lambda each: each.time))
        return
    for file in folder.iterdir():
        if not file.is_dir():
            open_regular(file).close()  # else a pipe would be waited for
    from rosbags.highlevel import AnyReader  # here, since it takes 0.2 s and few need it

    with AnyReader([folder], default_typestore=store_of_all()) as reader:
        ours = [connection for connection in reader.connections if connection.msgtype.startswith(PACKAGE)]
        for connection, time, content in reader.messages(ours):
            yield connection.msgtype, time, reader.deserialize(content, connection.msgtype)


def recording_of(messages: Iterable[tuple[str, int, Any]]) -> Recording:
    """Return what messages say, of a recording or of topics: there a batch's numbers come with its observations.

    Raises:
        ValueError: one of them says what cannot be.
    """
    recording, batches, sent = Recording(), dict[int, Batch](), dict[tuple[int, bool], tuple[Any, int]]()
    for kind, time, message in messages:
        match kind.removeprefix(PACKAGE):
            case "Task":
                recording.heads.append(head_of(message))
            case "Policy":
                recording.policies[message.version] = policy_of(message)
            case "Update":
                recording.updates.append(message)
            case "RecordedEpisodes":
                numbers = _numbers(message, message.episodes)
                recording.batches.append(_batch(recording.head, numbers, message.episodes, time))
            case "Observation":
                batches.setdefault(message.batch, _numbers(message, message))
            case "Episodes":
                is_discarded = any(execution.discard_reason for execution in message.executions)
                sent.setdefault(
                    (message.batch, is_discarded), (message, time)
                )  # a simulator may be asked for them again
    first = max((batch.first_episode + batch.num_envs for batch in batches.values()), default=0)
    for message, time in sent.values():  # now that all observations are seen, whose order with these nobody keeps
        if message.batch not in batches:
            batches[message.batch] = Batch(0, first, message.num_envs, message.horizon, explore=True)
            first += message.num_envs
        whole = _batch(None, batches[message.batch], message, time)
        recording.batches += [
            whole._replace(batch=kind, episodes=whole.episodes.take(rows), executions=whole.executions[rows])
            for kind, rows in whole.batch.kinds
        ]
    return recording


def _numbers(message: Any, sizes: Any) -> Batch:
    first, rows, horizon = (int(each) for each in (message.first_episode, sizes.num_envs, sizes.horizon))
    num_evaluation = {
        name: int(getattr(message, name, 0)) for name in ("num_evaluation", "first_evaluation")
    }  # of topics
    return Batch(int(message.seed), first, rows, horizon, explore=bool(message.explore), **num_evaluation)


def _batch(head: Head | None, batch: Batch, message: Any, time: int) -> RecordedBatch:
    d, n = len(message.final_observations) // batch.num_envs, len(message.actions) // (batch.num_envs * batch.horizon)
    spaces = head.spaces if head else Spaces.unbounded(d, n)
    return RecordedBatch(
        batch, message.policy_version, episodes_of(message, batch, spaces), executions_of(message), time
    )
