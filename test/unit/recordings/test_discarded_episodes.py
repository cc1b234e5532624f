"""An episode that is vetoed after it finished is discarded by all readers, in whichever order they read it."""

from collections.abc import Iterator
from dataclasses import replace
from itertools import groupby
from pathlib import Path

import numpy as np
import pytest

from rkhs_ros.policies.streams import Batch
from rkhs_ros.recordings.container import MessageFile, MessageReader, Stored
from rkhs_ros.recordings.definitions import decoded
from rkhs_ros.recordings.recording import Recording, read_recording
from rkhs_ros.runs.replay import replay
from test.unit.recordings.recorded_runs import ARRAYS, TRAINING, Robot, content, recorded_run, same_batch

pytestmark = pytest.mark.usefixtures("quick_disk")
VETOED = [(True, 0), (True, 3), (False, 2)]
STOPPED_AFTER = 6  # episodes; the last one is exploration episode 3, which is vetoed and not repeated
ORDERS = ["discarded first", "reversed"]


@pytest.fixture(scope="module")
def never_vetoed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return recorded_run(tmp_path_factory.mktemp("never") / "run", runner=Robot())


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return recorded_run(tmp_path_factory.mktemp("whole") / "run", runner=Robot(vetoed=VETOED))


def interrupted(folder: Path) -> Path:
    """Record a run that is interrupted between the veto of an episode and its repetition."""
    with pytest.raises(KeyboardInterrupt):
        recorded_run(folder, runner=Robot(episodes=STOPPED_AFTER, vetoed=VETOED[1:2]))
    return folder / "recording.mcap"


@pytest.fixture(scope="module")
def cut(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return interrupted(tmp_path_factory.mktemp("cut") / "run")


def is_discarded(stored: Stored) -> bool:
    message = decoded(stored.content, stored.kind, stored.definition)
    return any(execution.discard_reason for execution in message.episodes.executions)


def ordered(file: Path, order: str) -> Path:
    """Rewrite a recording with its episodes in another order, but each before its update."""
    messages: list[Stored] = []
    for are_episodes, group in groupby(
        MessageReader(file).news().messages, lambda each: each.kind.endswith("RecordedEpisodes")
    ):
        some = list(group)
        if are_episodes:
            some = some[::-1] if order == "reversed" else sorted(some, key=lambda each: not is_discarded(each))
        messages += some
    copy = file.with_name(f"{order}.mcap")
    MessageFile(copy, messages).close()
    return copy


def shuffles(recording: Recording, seed: int = 0) -> Iterator[Recording]:
    for order in np.random.default_rng(seed).permuted(np.tile(np.arange(len(recording.batches)), (20, 1)), axis=1):
        yield replace(recording, batches=[recording.batches[place] for place in order])


def test_completed_episodes_do_not_depend_on_the_order_of_messages(whole: Path, never_vetoed: Path) -> None:
    recording, expected = read_recording(whole), read_recording(never_vetoed)
    assert len(recording.batches) == len(expected.batches) + 2 * len(VETOED)
    assert recording.by_numbers().keys() == expected.by_numbers().keys()
    for each in (recording, *shuffles(recording)):
        found = each.by_numbers()
        assert all(same_batch(found[key], one) for key, one in expected.by_numbers().items())
        times = [one.time for one in found.values()]
        assert times == sorted(times)
        assert all(np.array_equal(getattr(each.episodes(), a), getattr(recording.episodes(), a)) for a in ARRAYS)


def test_a_vetoed_episode_without_a_repetition_is_discarded(cut: Path) -> None:
    recording = read_recording(cut)
    last = Batch(TRAINING.seed, 3, 1, TRAINING.horizon, explore=True)
    assert [each.batch for each in recording.batches[-2:]] == [last, last]
    assert [each.is_discarded for each in recording.batches[-2:]] == [False, True]
    for each in (recording, *shuffles(recording)):
        assert last not in each.by_numbers()
        assert len(each.by_numbers()) == STOPPED_AFTER - 1
        assert each.episodes().rewards.min() >= 0  # rewards of vetoed episodes are negative


@pytest.mark.parametrize("order", ORDERS)
def test_a_resumed_run_repeats_a_vetoed_episode(tmp_path: Path, never_vetoed: Path, order: str) -> None:
    file = interrupted(tmp_path / "run")
    ordered(file, order).replace(file)
    goes_on = Robot()
    recorded_run(tmp_path / "run", runner=goes_on, resume=True)
    assert goes_on.moved.count((True, 3)) == 1
    assert (True, 2) not in goes_on.moved
    assert (file.parent / "policy.npz").read_bytes() == (never_vetoed.parent / "policy.npz").read_bytes()
    assert content(read_recording(file))[2] == content(read_recording(never_vetoed))[2]  # the updates


def test_a_run_with_vetoes_replays(whole: Path, cut: Path) -> None:
    assert len(list(replay(read_recording(ordered(whole, "discarded first"))))) == 4
    assert len(list(replay(read_recording(cut)))) == 1
