"""Recording of a run, which can resume from its recording."""

import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from itertools import groupby
from pathlib import Path
from typing import Protocol

from rkhs_ros.base.validation import require
from rkhs_ros.base.yaml_text import LEARNER, PARAMETERS, loaded
from rkhs_ros.learning.episodes import Episodes, Record
from rkhs_ros.learning.iteration import Iteration
from rkhs_ros.learning.replay import check_actions
from rkhs_ros.learning.state import State, remembered
from rkhs_ros.learning.training import Runner
from rkhs_ros.learning.training_settings import Training, training_from
from rkhs_ros.policies.gaussian import GaussianPolicy
from rkhs_ros.policies.spaces import Spaces
from rkhs_ros.policies.streams import Batch
from rkhs_ros.recordings.container import MessageFile
from rkhs_ros.recordings.recorder import Recorder, read_held
from rkhs_ros.recordings.recording import FILE, Head, RecordedBatch
from rkhs_ros.runs.checkpoint import FREE, Checkpoint
from rkhs_ros.runs.config import Config
from rkhs_ros.runs.report import provenance_lines, resolved


class RecordableRunner(Runner, Protocol):
    """Runner that reports each finished batch."""

    record: Record


class RecordingRunner:
    """Runner that records the episodes of another runner, and does not repeat episodes that are already recorded.

    Args:
        runner: the other runner.
        recorder: recorder of the run.
        held: recorded episodes that no update has used yet, by number.
        state: state of the run, from which it resumes; None for a new run.
    """

    def __init__(
        self,
        runner: RecordableRunner,
        recorder: Recorder,
        held: Mapping[Batch, RecordedBatch],
        state: State | None = None,
    ) -> None:
        self.state = state
        self._runner = runner
        self._held = held
        self._recorder = recorder

    @property
    def spaces(self) -> Spaces:
        """Shape of an observation, and bounds of the actions."""
        return self._runner.spaces

    def capacity(self, num_envs: int) -> int:
        """Return how many of the environments can run in one batch."""
        return self._runner.capacity(num_envs)

    def collect(self, policy: GaussianPolicy, batch: Batch) -> Episodes:
        """Return the episodes of a batch under the policy.

        Raises:
            ValueError: another policy acted in the recorded episodes.
        """
        self._recorder.serve(policy)
        parts: list[Episodes] = []
        episodes = batch.parts(1)
        for is_held, group in groupby(range(batch.num_envs), lambda env: episodes[env] in self._held):
            envs = list(group)
            part = batch.part(envs[0], envs[-1] + 1)
            parts.append(self._recorded(policy, part) if is_held else self._runner.collect(policy, part))
        return Episodes.concatenate(parts)

    def updated(self, iteration: Iteration) -> None:
        """Record the result of an iteration."""
        self._recorder.updated(iteration)

    def _recorded(self, policy: GaussianPolicy, batch: Batch) -> Episodes:
        episodes = Episodes.concatenate(self._held[each].episodes for each in batch.parts(1))
        check_actions(episodes, policy, batch)
        return episodes


@contextmanager
def recorded(
    config: Config,
    runner: RecordableRunner,
    folder: Path,
    found: Checkpoint | None,
    *,
    sync: bool,
) -> Iterator[RecordingRunner]:
    """Record a run in its folder, or continue its recording; print a warning if it was recorded with other versions.

    Args:
        config: configuration of the run.
        runner: runner of the episodes.
        folder: folder of the run.
        found: checkpoint from which the run begins or resumes, if any.
        sync: sync each message to the disk, such as for a robot, whose episodes are costly.

    Raises:
        ValueError: the recording belongs to another run, or lacks finished iterations or their episodes.
        OSError: the recording cannot be read or written.
    """
    warm_start = found is not None and found.given is not None
    file, head = folder / FILE, head_of_run(config, runner.spaces, warm_start=warm_start)
    done, is_robot = found.state.iterations if found else 0, bool(config.environment.nodes)
    held, messages = read_held(file, done, keeps_later=is_robot)
    is_new = not held.heads or held.heads[-1].versions != head.versions
    if held.heads:
        _check_same_run(file, held.head, head)
    if held.heads and is_new:
        print(f"warning: {file}: {_changes(held.heads[-1].versions, head.versions)}", file=sys.stderr)
    episodes = held.by_numbers()
    state = None
    if found and done:
        ends, policy = [row.episodes for row in found.rows], found.state.policy
        memory = memory_of(ends, config.training, policy, runner.spaces, episodes, f"{file}")
        state = replace(found.state, memory=memory)
    counts = (state.evaluated, state.explored) if state else (0, 0)
    later = {each: episode for each, episode in episodes.items() if each.first_episode >= counts[each.explore]}
    recorder, record_before = Recorder(MessageFile(file, messages, sync=sync), held), runner.record
    runner.record = recorder.ended
    try:
        if is_new:
            recorder.begin(head)
        yield RecordingRunner(runner, recorder, later, state)
    finally:
        runner.record = record_before
        recorder.close()


def memory_of(
    ends: Sequence[int],
    training: Training,
    policy: GaussianPolicy,
    spaces: Spaces,
    episodes: Mapping[Batch, RecordedBatch],
    what: str,
) -> Episodes:
    """Return the episodes that a run remembers after its finished iterations.

    Args:
        ends: number of exploration episodes after each finished iteration, at least one.
        training: settings of the run.
        policy: policy after the last iteration.
        spaces: spaces of the task.
        episodes: the recorded episodes by number.
        what: name of the recording, used in error messages.

    Raises:
        ValueError: an episode is not recorded.
    """
    memory = Episodes.none(1, 1, 1)
    for begin in [0, *ends[:-1]]:
        batch = Batch(training.seed, begin, training.episodes_per_iteration, training.horizon, explore=True)
        missing = [each.first_episode for each in batch.parts(1) if each not in episodes]
        require(not missing, what, "the exploration episodes of the finished iterations", f"none of number {missing}")
        exploration = Episodes.concatenate(episodes[each].episodes for each in batch.parts(1))
        memory = remembered(memory, exploration, training, policy, spaces)
    return memory


def head_of_run(config: Config, spaces: Spaces, *, warm_start: bool) -> Head:
    """Return the header of the recording of a run."""
    return Head(config.task, spaces, config.training.seed, resolved(config), provenance_lines(), warm_start)


def training_of(head: Head) -> Training:
    """Return the settings of the learner from the header of a recording.

    Raises:
        ValueError: the settings are invalid.
    """
    return training_from(loaded(head.configuration)[LEARNER][PARAMETERS])


def _changes(before: Sequence[str], now: Sequence[str]) -> str:
    """Return a sentence about the versions that have changed."""
    began, resumes = (", ".join(sorted(set(one) - set(other))) for one, other in ((before, now), (now, before)))
    return f"begun with {began}, resumed with {resumes}; the results may differ from those of an uninterrupted run"


def _check_same_run(file: Path, began: Head, resumed: Head) -> None:
    """Raise ValueError if a recording belongs to another run than the one that resumes."""
    trainings = [training_of(head) for head in (began, resumed)]
    free = {name: getattr(trainings[1], name) for name in FREE}
    settings = [replace(training, **free) for training in trainings]
    same = settings[0] == settings[1] and began.task == resumed.task
    require(same, f"{file}", "the recording of this run, with equal settings", "that of another run")
