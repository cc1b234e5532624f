"""Replay of a run from its recording: equal episodes must give bit-identical updates."""

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np

from rkhs_ros.base.validation import require, truncated
from rkhs_ros.learning.episodes import Episodes
from rkhs_ros.learning.iteration import Iteration
from rkhs_ros.learning.replay import check_actions
from rkhs_ros.learning.state import first_state
from rkhs_ros.learning.training import train
from rkhs_ros.policies.gaussian import GaussianPolicy
from rkhs_ros.policies.spaces import Spaces
from rkhs_ros.policies.storage import policy_arrays
from rkhs_ros.policies.streams import Batch
from rkhs_ros.recordings.recorder import update_fields
from rkhs_ros.recordings.recording import Recording
from rkhs_ros.runs.config import config_of
from rkhs_ros.runs.recorded import check_trained


class DifferenceError(ValueError):
    """Raised if a recomputed result differs from the recorded one."""


class RecordedRunner:
    """Runner that returns recorded episodes instead of running new ones, and knows the number of the update."""

    def __init__(self, recording: Recording, spaces: Spaces) -> None:
        self.spaces = spaces
        self.update = 1
        self._recording = recording
        self._episodes = recording.by_numbers()

    def collect(self, policy: GaussianPolicy, batch: Batch) -> Episodes:
        """Return the episodes of a batch under the policy."""
        return Episodes.concatenate(self._episode(policy, part) for part in batch.parts(1))

    def _episode(self, policy: GaussianPolicy, batch: Batch) -> Episodes:
        number, kind = batch.first_episode, "exploration" if batch.explore else "evaluation"
        recorded = self._episodes.get(batch)
        if recorded is None:
            raise ValueError(f"update {self.update}: expected {kind} episode {number} in the recording, got none")
        where = f"update {self.update}, {kind} episode {number}"
        self.check_policy(policy, recorded.version, where)
        try:
            check_actions(recorded.episodes, policy, batch)
        except ValueError as error:
            raise DifferenceError(f"update {self.update}, {kind} {error}") from error
        return recorded.episodes

    def check_policy(self, policy: GaussianPolicy, version: int, where: str) -> None:
        """Raise DifferenceError unless a recomputed policy is bit-identical to the recorded policy of a version."""
        if version not in self._recording.policies:
            raise ValueError(f"{where}: expected policy {version} in the recording, got none")
        again = policy_arrays(policy)
        for name, array in policy_arrays(self._recording.policies[version]).items():
            _check_same(f"{where}: policy {version}, {name}", array, again.get(name, ()))


def replay(recording: Recording) -> Iterator[Iteration]:
    """Recompute every update of a recording, and yield each one that is bit-identical.

    Raises:
        ValueError: something required is not recorded.
        DifferenceError: an update differs; the message names the first difference.
    """
    head = recording.head
    require(bool(recording.updates), "recording", "the recording of a run with updates", "no updates")
    check_trained(recording, "recording")
    given = recording.policies.get(1) if head.warm_start else None
    require(given is not None or not head.warm_start, "recording", "the initial policy", "none")
    runner = RecordedRunner(recording, head.spaces)
    training = replace(config_of(head.configuration).training, iterations=len(recording.updates))
    for iteration in train(training, runner, first_state(training, head.spaces, given)):
        update = recording.updates[iteration.number - 1]
        where = f"update {iteration.number}"
        require(
            update.iteration == iteration.number, where, "all earlier updates", f"update {update.iteration} instead"
        )
        for name, value in update_fields(iteration).items():
            _check_same(f"{where}, {name}", getattr(update, name), value)
        runner.check_policy(iteration.policy, update.policy_version, where)
        runner.check_policy(iteration.state.explorer, update.explorer_version, where)
        runner.update += 1
        yield iteration


def _check_same(where: str, recorded: Any, again: Any) -> None:
    """Raise DifferenceError at the first number of two arrays that is not bit-identical."""
    one, other = np.atleast_1d(recorded), np.atleast_1d(again)
    if one.dtype.kind in "fiu":
        other = other.astype(one.dtype)
    if one.shape != other.shape:
        raise DifferenceError(f"{where}: recorded {one.size} numbers, recomputed {other.size}")
    if one.tobytes() != other.tobytes():
        first = next(place for place in np.ndindex(one.shape) if one[place].tobytes() != other[place].tobytes())
        place = list(first) if np.ndim(recorded) else ""
        raise DifferenceError(f"{where}{place}: recorded {truncated(one[first])}, recomputed {truncated(other[first])}")
