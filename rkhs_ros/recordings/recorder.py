"""Recorder of a run, and the content of the recording that a resumed run continues."""

import json
import os
import time
from dataclasses import fields
from hashlib import blake2b
from pathlib import Path
from typing import Any

import numpy as np

from rkhs_ros.base.validation import require
from rkhs_ros.learning.episodes import Episodes, Execution
from rkhs_ros.learning.iteration import Iteration
from rkhs_ros.policies.gaussian import GaussianPolicy
from rkhs_ros.policies.messages import doubles, policy_message, spaces_fields
from rkhs_ros.policies.storage import policy_arrays
from rkhs_ros.policies.streams import Batch
from rkhs_ros.recordings.container import MessageFile, Stored
from rkhs_ros.recordings.definitions import PACKAGE, Types, decoded, definition, encoded
from rkhs_ros.recordings.messages import episodes_message
from rkhs_ros.recordings.recording import Head, Recording, faults_named, intact_messages, recording_of

TYPES = Types()
TASK, UPDATE = f"{PACKAGE}Task", f"{PACKAGE}Update"
ARRAYS = [f.name for f in fields(Episodes)]
TOPICS = {"Task": "task", "Policy": "policy", "RecordedEpisodes": "recorded_episodes", "Update": "update"}


class Recorder:
    """Writes the policies, batches and updates of a run to a file, each of them once.

    Owns the versions of the policies by digest, and the numbers of recorded batches and updates.

    Args:
        file: file of the recording.
        held: content that the file already holds.
    """

    def __init__(self, file: MessageFile, held: Recording) -> None:
        self._file = file
        self._versions = {_digest(policy): version for version, policy in held.policies.items()}
        self._served = 0
        self._batches = len(held.batches)
        self._updates = max((update.iteration for update in held.updates), default=0)

    def begin(self, head: Head) -> None:
        """Record the header, which must be first."""
        fields = {name: getattr(head, name) for name in ("seed", "configuration", "warm_start")}
        task = {"environment": head.task.environment, "horizon": head.task.horizon, "discount": head.task.discount}
        options = json.dumps(dict(head.task.options))
        versions = list(head.versions)
        self._write(TYPES.Task(**fields, **task, **spaces_fields(head.spaces), options=options, versions=versions))

    def serve(self, policy: GaussianPolicy) -> None:
        """Record the policy for the next batches."""
        self._served = self._version(policy)

    def ended(self, batch: Batch, episodes: Episodes, executions: list[Execution]) -> None:
        """Record a finished or discarded batch of the current policy."""
        self._batches += 1
        numbers = {"seed": batch.seed, "first_episode": batch.first_episode, "explore": batch.explore}
        message = episodes_message(TYPES, self._batches, self._served, episodes, executions)
        stamps = [int(execution.stamps[-1]) for execution in executions if len(execution.stamps)]
        self._write(TYPES.RecordedEpisodes(**numbers, episodes=message), max(stamps, default=None))

    def updated(self, iteration: Iteration) -> None:
        """Record the result of an iteration, the policy after it, and the checksum of its episodes."""
        if iteration.number > self._updates:
            self._updates = iteration.number
            policy, explorer = self._version(iteration.policy), self._version(iteration.state.explorer)
            self._write(TYPES.Update(policy_version=policy, explorer_version=explorer, **update_fields(iteration)))

    def close(self) -> None:
        """Close the recording."""
        self._file.close()

    def _version(self, policy: GaussianPolicy) -> int:
        """Return the version of a policy; record the policy if it is new."""
        digest = _digest(policy)
        if digest not in self._versions:
            self._versions[digest] = len(self._versions) + 1
            self._write(policy_message(TYPES, policy, self._versions[digest]))
        return self._versions[digest]

    def _write(self, message: Any, published: int | None = None) -> None:
        kind, now = message.__msgtype__, time.time_ns()
        topic = TOPICS[kind.rpartition("/")[2]]
        made = now if published is None else published
        self._file.write(Stored(topic, kind, definition(kind), encoded(message), now, made))


def update_fields(iteration: Iteration) -> dict[str, Any]:
    """Return the fields of the message of an iteration, except the versions of policies."""
    known = iteration.row(seconds=0.0)._asdict()
    known.pop("seconds")  # the message has a time stamp
    return {
        **known,
        "exploration_returns": doubles(iteration.exploration_returns),
        "evaluation_returns": doubles(iteration.evaluation_returns),
        "checksum": _checksum(iteration),
    }


def _checksum(iteration: Iteration) -> int:
    digest = blake2b(digest_size=8)
    for episodes in (iteration.exploration, *iteration.tried, iteration.evaluation):
        for name in ARRAYS:
            digest.update(np.ascontiguousarray(getattr(episodes, name)).tobytes())
    return int.from_bytes(digest.digest(), "little")


def _digest(policy: GaussianPolicy) -> bytes:
    digest = blake2b(digest_size=16)
    for name, array in policy_arrays(policy).items():
        digest.update(f"{name} {array.dtype} {array.shape} ".encode() + array.tobytes())
    return digest.digest()


def read_held(path: Path, iterations: int, *, keeps_later: bool) -> tuple[Recording, list[Stored]]:
    """Return what a resumed run keeps of its recording, and its messages; both are empty without a file.

    The updates are those of all finished iterations but the last one of the run, which a resume repeats for its
    result. The run rewrites the file with these messages.

    Args:
        path: the recording.
        iterations: planned number of iterations.
        keeps_later: whether to keep what was recorded after these iterations, since the episodes of a robot are not
            repeated.

    Raises:
        ValueError: the file is not a recording, or more iterations are finished than planned.
        OSError: the file cannot be read.
    """
    found = intact_messages(path) if os.path.lexists(path) else []
    with faults_named(path):
        ends = [0]  # numbers of messages up to update 0, 1, 2, ...
        for count, each in enumerate(found, 1):
            if each.kind == UPDATE and decoded(each.content, each.kind, each.definition).iteration == len(ends):
                ends.append(count)
        kept = ends[min(len(ends), iterations) - 1]
        later = (each for each in found[kept:] if each.kind == TASK or (keeps_later and each.kind != UPDATE))
        messages = [*found[:kept], *later]
        recording = recording_of(messages)
    finished = len(ends) - 1
    require(finished <= iterations, "iterations", f"at least {finished}, the finished ones", iterations)
    return (recording, messages) if recording.heads else (Recording(), [])
