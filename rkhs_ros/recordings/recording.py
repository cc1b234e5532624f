"""Content of a recording as values: header, policies, batches of episodes and updates."""

from __future__ import annotations

import json
import sys
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

from rkhs_ros.base.validation import require, truncated
from rkhs_ros.learning.episodes import Episodes, Execution
from rkhs_ros.policies.gaussian import GaussianPolicy
from rkhs_ros.policies.messages import policy_of, spaces_of
from rkhs_ros.policies.spaces import Spaces
from rkhs_ros.policies.storage import Task
from rkhs_ros.policies.streams import Batch
from rkhs_ros.recordings.container import MessageReader, Stored
from rkhs_ros.recordings.definitions import PACKAGE, decoded
from rkhs_ros.recordings.messages import episodes_of, executions_of

FILE = "recording.mcap"


class RecordedBatch(NamedTuple):
    """Recorded batch of episodes."""

    batch: Batch
    version: int  # of the policy that acted
    episodes: Episodes
    executions: list[Execution]  # on a robot; empty for a simulation
    time: int  # of the recording, in nanoseconds since 1970

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


@dataclass(frozen=True)
class Head:
    """Header of a recording: task and settings of the run.

    Attributes:
        task: task of the run.
        spaces: spaces of the task.
        seed: seed of all randomness.
        configuration: all settings, as a ROS parameter file.
        versions: versions of code and libraries, "name version" each.
        warm_start: whether an initial policy was given.
    """

    task: Task
    spaces: Spaces
    seed: int
    configuration: str
    versions: tuple[str, ...]
    warm_start: bool


@dataclass
class Recording:
    """Content of a recording.

    Attributes:
        heads: headers; the run adds one if it resumes with other versions.
        policies: policies by version.
        batches: batches in the order in which they ended, including discarded ones.
        updates: messages of the finished iterations.
    """

    heads: list[Head] = field(default_factory=list)
    policies: dict[int, GaussianPolicy] = field(default_factory=dict)
    batches: list[RecordedBatch] = field(default_factory=list)
    updates: list[Any] = field(default_factory=list)

    def add(self, kind: str, time: int, message: Any) -> None:
        """Add the content of a message, given its type and the time of its recording.

        Raises:
            ValueError: the message is invalid.
        """
        match kind.removeprefix(PACKAGE):
            case "Task":
                task = Task(message.environment, json.loads(message.options), message.horizon, message.discount)
                about = message.seed, message.configuration, tuple(message.versions), bool(message.warm_start)
                self.heads.append(Head(task, spaces_of(message), *about))
            case "Policy":
                self.policies[message.version] = policy_of(message)
            case "Update":
                self.updates.append(message)
            case "RecordedEpisodes":
                episodes, numbers = message.episodes, (int(message.seed), int(message.first_episode))
                sizes = int(episodes.num_envs), int(episodes.horizon)
                batch = Batch(*numbers, *sizes, explore=bool(message.explore))
                held = episodes_of(episodes, batch, self.head.spaces), executions_of(episodes)
                self.batches.append(RecordedBatch(batch, episodes.policy_version, *held, time))

    @property
    def head(self) -> Head:
        """The first header.

        Raises:
            ValueError: there is none.
        """
        require(bool(self.heads), "recording", "a header", "none")
        return self.heads[0]

    @property
    def action_repeat(self) -> int | None:
        """Action repeat of the newest trained policy; None if there is none."""
        trained = [policy for policy in self.policies.values() if len(policy.mean.centres) > 0]
        return trained[-1].action_repeat if trained else None

    def episodes(self) -> Episodes:
        """Return all completed episodes, each once.

        Raises:
            ValueError: there are no episodes.
        """
        finished = self.by_numbers()
        require(bool(finished), "recording", "at least one finished episode", "none")
        return Episodes.concatenate(each.episodes for each in finished.values())

    def exploration(self, iteration: int) -> Episodes:
        """Return the exploration episodes of a finished iteration, before its update.

        All iterations of an offline run have the same episodes.

        Raises:
            ValueError: an episode or the update is missing.
        """
        update = self._update(iteration)
        begin = max((each.episodes for each in self.updates if each.episodes < update.episodes), default=0)
        return self.numbered(begin, len(update.exploration_returns), explore=True)

    def evaluation(self, iteration: int) -> Episodes | None:
        """Return the evaluation episodes after the update of an iteration; None if it was not evaluated.

        Raises:
            ValueError: an episode or the update is missing.
        """
        update = self._update(iteration)
        count = len(update.evaluation_returns)
        return self.numbered(update.evaluation_episodes - count, count, explore=False) if count else None

    def last_episodes(self) -> Episodes:
        """Return the evaluation episodes after the last update, or its exploration episodes if it was not evaluated.

        Raises:
            ValueError: there is no update, or an episode is missing.
        """
        require(bool(self.updates), "recording", "at least one finished iteration", "none")
        last = self.updates[-1].iteration
        return self.evaluation(last) or self.exploration(last)

    def numbered(self, begin: int, count: int, *, explore: bool) -> Episodes:
        """Return the completed episodes with some successive numbers.

        Raises:
            ValueError: an episode is missing.
        """
        near = [
            each
            for each in self.batches
            if each.batch.explore == explore
            and each.batch.first_episode < begin + count
            and each.batch.first_episode + each.batch.num_envs > begin
        ]
        known = {batch.first_episode: each.episodes for batch, each in countable(near).items()}
        missing = [number for number in range(begin, begin + count) if number not in known]
        require(not missing, "recording", f"episodes {begin} to {begin + count - 1}", f"none of number {missing}")
        return Episodes.concatenate(known[number] for number in range(begin, begin + count))

    def _update(self, iteration: int) -> Any:
        found = next((each for each in self.updates if each.iteration == iteration), None)
        require(found is not None, "recording", f"the update of iteration {iteration}", "none")
        return found

    def by_numbers(self) -> dict[Batch, RecordedBatch]:
        """Return the completed episodes by number, each as a batch of one episode."""
        return countable(self.batches)


def recording_file(path: Path) -> Path:
    """Return the recording in the folder of a run; return a file unchanged.

    Raises:
        FileNotFoundError: there is no recording.
    """
    file = path / FILE if path.is_dir() else path
    if not file.is_file():
        raise FileNotFoundError(f"{path}: no {FILE} in this folder" if path.is_dir() else f"{path}: no such recording")
    return file


def read_recording(path: Path) -> Recording:
    """Read a recording; skip damaged parts with a warning on standard error.

    Args:
        path: an MCAP file, or the folder of a recorded run.

    Raises:
        ValueError: the file is not a recording, or contains none of our messages.
        OSError: the file cannot be read.
    """
    path = recording_file(path)
    messages = intact_messages(path)
    with faults_named(path):
        recording = recording_of(messages)
    require(bool(recording.heads), f"{path}", "a recording of a run", "no header")
    return recording


@contextmanager
def faults_named(path: Path) -> Iterator[None]:
    """Report errors from the messages of a recording as a ValueError with its path."""
    try:
        yield
    except OSError:
        raise
    except Exception as error:
        why = str(error) if isinstance(error, ValueError) else f"{type(error).__name__}: {error}"
        if why.startswith(f"{path}"):
            raise
        raise ValueError(f"{path}: expected the messages of a run, got invalid ones ({truncated(why)})") from error


def intact_messages(path: Path) -> list[Stored]:
    """Return the intact messages of an MCAP file; print warnings about damaged parts."""
    found = MessageReader(path).news()
    for fault in found.faults:
        print(f"warning: {path}: {fault}", file=sys.stderr)
    return found.messages


def own_messages(messages: Iterable[Stored]) -> Iterator[tuple[str, int, Any]]:
    """Yield the type, the time and the content of each message of this project."""
    for stored in messages:
        if stored.kind.startswith(PACKAGE):
            yield stored.kind, stored.time, decoded(stored.content, stored.kind, stored.definition)


def recording_of(messages: Iterable[Stored]) -> Recording:
    """Return the content of messages.

    Raises:
        ValueError: a message is invalid.
    """
    recording = Recording()
    for kind, time, message in own_messages(messages):
        recording.add(kind, time, message)
    return recording
