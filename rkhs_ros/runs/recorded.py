"""Recording of a run, which can resume from its recording."""

import sys
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from itertools import groupby
from pathlib import Path
from typing import Protocol

from rkhs_ros.base.files import sync_to_disk
from rkhs_ros.base.validation import require
from rkhs_ros.learning.diagnosis import Summary, summary_of
from rkhs_ros.learning.episodes import Episodes, Record
from rkhs_ros.learning.iteration import Iteration, Row
from rkhs_ros.learning.replay import check_actions
from rkhs_ros.learning.state import State, first_state, remembered
from rkhs_ros.learning.training import EARLIER, Runner
from rkhs_ros.learning.training_settings import ModelBased, Training
from rkhs_ros.policies.gaussian import GaussianPolicy
from rkhs_ros.policies.spaces import Spaces
from rkhs_ros.policies.streams import Batch
from rkhs_ros.recordings.container import MessageFile
from rkhs_ros.recordings.recorder import Recorder, read_held
from rkhs_ros.recordings.recording import FILE, Head, RecordedBatch, Recording
from rkhs_ros.runs.config import Config, config_of
from rkhs_ros.runs.curve import Curve
from rkhs_ros.runs.report import INITIAL_POLICY, initial_policy, provenance_lines, resolved

FREE = ("iterations", "timeout")  # settings that do not affect the result of an iteration
SYNC_PERIOD_S = 1.0  # waiting for the disk takes longer than many iterations


class RecordableRunner(Runner, Protocol):
    """Runner that reports each finished batch."""

    record: Record


class RecordingRunner:
    """Runner that records the episodes of another runner, and does not repeat episodes that are already recorded.

    Args:
        held: recorded episodes that no update has used yet, by number.
    """

    def __init__(
        self, runner: RecordableRunner, recorder: Recorder, file: Path, held: Mapping[Batch, RecordedBatch]
    ) -> None:
        self._runner = runner
        self._held = held
        self._recorder = recorder
        self._file = file
        self._due = 0.0  # next sync to the disk, monotonic time in seconds

    @property
    def spaces(self) -> Spaces:
        """Shape of an observation, and bounds of the actions."""
        return self._runner.spaces

    def collect(self, policy: GaussianPolicy, batch: Batch) -> Episodes:
        """Return the episodes of a batch under the policy."""
        self._recorder.serve(policy)
        parts: list[Episodes] = []
        episodes = batch.parts(1)
        for is_held, group in groupby(range(batch.num_envs), lambda env: episodes[env] in self._held):
            envs = list(group)
            part = batch.part(envs[0], envs[-1] + 1)
            parts.append(self._recorded(policy, part) if is_held else self._runner.collect(policy, part))
        return Episodes.concatenate(parts)

    def updated(self, iteration: Iteration) -> None:
        """Record the result of an iteration; the recording is on the disk at most a second later."""
        self._recorder.updated(iteration)
        if time.monotonic() >= self._due:
            sync_to_disk(self._file)
            self._due = time.monotonic() + SYNC_PERIOD_S

    def _recorded(self, policy: GaussianPolicy, batch: Batch) -> Episodes:
        episodes = _joined(self._held, batch, f"{self._file}")
        check_actions(episodes, policy, batch)
        return episodes


# What a run has reached when it begins or resumes: the runner of the further episodes, the state, and the rows, the
# policies and the summaries of the finished iterations.
Progress = tuple[RecordingRunner, State, Sequence[Row], Sequence[GaussianPolicy], Sequence[Summary]]


@contextmanager
def recorded(config: Config, runner: RecordableRunner, folder: Path, *, is_robot: bool) -> Iterator[Progress]:
    """Record a run in its folder, or continue its recording; print a warning if it was recorded with other versions.

    The episodes of a robot are costly: each message is synced to the disk, and no finished episode is repeated.

    Raises:
        ValueError: the recording belongs to another run, or lacks episodes, or the environment has changed.
    """
    given, training = initial_policy(folder), config.training
    file, head = folder / FILE, head_of_run(config, runner.spaces, warm_start=given is not None)
    held, messages = read_held(file, training.iterations, keeps_later=is_robot)
    is_new = not held.heads or held.heads[-1].versions != head.versions
    results = [name for name in ("curve.csv", "policy.npz") if (folder / name).exists()]
    remedy = "Restore the file, or train in another folder"
    require(bool(held.heads) or not results, f"{file}", f"the recording of {', '.join(results)}", f"none. {remedy}")
    if held.heads:
        _check_same_run(folder, held.head, head)
    if held.updates:
        state = state_of(held, training, runner.spaces, f"{file}")
        _check_spaces(folder, state.policy, runner.spaces)
    else:
        state = first_state(training, runner.spaces, given)
    if held.heads and is_new:
        print(f"warning: {file}: {_changes(held.heads[-1].versions, head.versions)}", file=sys.stderr)
    counts, episodes = (state.evaluated, state.explored), held.by_numbers()
    later = {each: found for each, found in episodes.items() if each.first_episode >= counts[each.explore]}
    rows = _rows(held, folder)
    summaries = _summaries(held, rows, episodes, training, runner.spaces, f"{file}")
    recorder, record_before = Recorder(MessageFile(file, messages, sync=is_robot), held), runner.record
    runner.record = recorder.ended
    try:
        if is_new:
            recorder.begin(head)
        policies = [held.policies[update.policy_version] for update in held.updates]
        yield RecordingRunner(runner, recorder, file, later), state, rows, policies, summaries
    finally:
        runner.record = record_before
        recorder.close()


def state_of(recording: Recording, training: Training, spaces: Spaces, what: str) -> State:
    """Return the state of a run after the updates of its recording.

    The recording has at least one update; ``what`` names it in error messages.

    Raises:
        ValueError: an episode or a policy is not recorded, or the recording is that of an offline run.
    """
    check_trained(recording, what)
    *_, last = updates = recording.updates
    versions = [1, *(update.explorer_version for update in updates)]  # version 1 acted first
    absent = sorted({*versions, *(update.policy_version for update in updates)} - set(recording.policies))
    require(not absent, what, "the policies of the finished iterations", f"none of version {absent}")
    explorer, *earlier = (recording.policies[version] for version in reversed(versions))
    episodes, memory = recording.by_numbers(), Episodes.none(1, 1, 1)
    for begin in [0, *(update.episodes for update in updates[:-1])]:
        batch = Batch(training.seed, begin, training.episodes_per_iteration, training.horizon, explore=True)
        memory = remembered(memory, _joined(episodes, batch, what), training, explorer, spaces)
    known = tuple(earlier[:EARLIER]) if isinstance(training.model, ModelBased) else ()
    policy, counts = recording.policies[last.policy_version], (last.episodes, last.evaluation_episodes, last.steps)
    return State(last.iteration, policy, explorer, memory, *counts, known)


def check_trained(recording: Recording, what: str) -> None:
    """Raise ValueError for the recording of an offline run, whose episodes have no policy."""
    is_trained = all(batch.version for batch in recording.batches)
    require(is_trained, what, "the recording of a run with new episodes", "that of an offline run")


def head_of_run(config: Config, spaces: Spaces, *, warm_start: bool) -> Head:
    """Return the header of the recording of a run."""
    return Head(config.task, spaces, config.training.seed, resolved(config), provenance_lines(), warm_start)


def _rows(held: Recording, folder: Path) -> list[Row]:
    """Return the rows of the updates, with the seconds of the curve; a lost line has those of the last known one."""
    seconds: dict[int, float] = {}
    with suppress(ValueError):  # from a damaged curve, which the run writes again
        seconds = {row.iteration: row.seconds for row in Curve(folder / "curve.csv").rows()}
    last = max(seconds.values(), default=0.0)
    known = [{name: getattr(each, name) for name in Row._fields if name != "seconds"} for each in held.updates]
    return [Row(**each, seconds=seconds.get(each["iteration"], last)) for each in known]


def _joined(episodes: Mapping[Batch, RecordedBatch], batch: Batch, what: str) -> Episodes:
    """Return the recorded episodes of a batch; raise ValueError if one is missing."""
    parts, kind = batch.parts(1), "exploration" if batch.explore else "evaluation"
    missing = [each.first_episode for each in parts if each not in episodes]
    require(not missing, what, f"the {kind} episodes of the finished iterations", f"none of number {missing}")
    return Episodes.concatenate(episodes[each].episodes for each in parts)


def _summaries(
    held: Recording,
    rows: Sequence[Row],
    episodes: Mapping[Batch, RecordedBatch],
    training: Training,
    spaces: Spaces,
    what: str,
) -> list[Summary]:
    """Summarise the finished iterations of a resumed run for its diagnosis."""
    summaries: list[Summary] = []
    explored = evaluated = 0
    for row, update in zip(rows, held.updates, strict=True):
        batch = Batch(training.seed, explored, training.episodes_per_iteration, training.horizon, explore=True)
        exploration = _joined(episodes, batch, what)
        if count := update.evaluation_episodes - evaluated:
            batch = Batch(training.seed, evaluated, count, training.horizon, explore=False)
            evaluation = _joined(episodes, batch, what)
        else:
            evaluation = exploration.take(slice(0))
        summaries.append(summary_of(row, exploration, evaluation, spaces))
        explored, evaluated = update.episodes, update.evaluation_episodes
    return summaries


def _changes(before: Sequence[str], now: Sequence[str]) -> str:
    began, resumes = (", ".join(sorted(set(one) - set(other))) for one, other in ((before, now), (now, before)))
    return f"begun with {began}, resumed with {resumes}; the results may differ from those of an uninterrupted run"


def _check_same_run(folder: Path, began: Head, resumed: Head) -> None:
    """Raise ValueError if a run resumes with another setting that affects its results, or without its first policy."""
    both = ["none", "the initial policy of the run"]
    expected, got = both[began.warm_start], both[resumed.warm_start]
    require(expected == got, f"{folder / INITIAL_POLICY}", expected, got)
    old, new = (config_of(head.configuration).settings for head in (began, resumed))
    for name in [*new, *old]:
        expected, got = (each.get(name, "no such setting") for each in (old, new))
        what = f"{folder}: {name}"
        require(
            name in FREE or expected == got, what, f"{expected} as at the start of the run", f"{got}. Start another run"
        )


def _check_spaces(folder: Path, policy: GaussianPolicy, spaces: Spaces) -> None:
    """Raise ValueError if the environment has other dimensions than at the start, such as an edited class."""
    n = spaces.action_dim
    sizes = (policy.mean.input_dim, policy.mean.output_dim), (policy.inputs.dimension(spaces.observation_dim, n), n)
    expected, got = (f"{d} inputs and {n} actions" for d, n in sizes)
    require(expected == got, f"{folder}: environment", f"{expected} as at the start of the run", got)
