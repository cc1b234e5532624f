"""An episode that is vetoed after it finished is discarded by all readers, in whichever order they read it."""

from collections.abc import Callable, Iterator
from dataclasses import replace
from itertools import groupby
from pathlib import Path

import numpy as np
import pytest
from rosbags.rosbag2 import StoragePlugin

from rkhs_ros.policies.streams import Batch
from rkhs_ros.recordings.container import MessageFile, Stored, read_messages
from rkhs_ros.recordings.definitions import decoded
from rkhs_ros.recordings.recording import Recording, read_recording
from rkhs_ros.runs.replay import replay
from test.unit.conftest import Result
from test.unit.recordings.recorded_runs import ARRAYS, TRAINING, Robot, bag, content, longer, recorded_run

pytestmark = pytest.mark.usefixtures("quick_disk")
VETOED = [(True, 0), (True, 3), (False, 2)]
STOPPED_AFTER = 6  # episodes; the last one is exploration episode 3, which is vetoed and not repeated
SHORT = ("--iterations", 1, "--set", "model.updates=2", "model.rollouts=5", "--quiet")
ORDERS = ["as recorded", "discarded first", "reversed"]


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
    if order == "as recorded":
        return file
    messages: list[Stored] = []
    for are_episodes, group in groupby(
        read_messages(file).messages, lambda each: each.kind.endswith("RecordedEpisodes")
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
        assert all(found[key].has_same_episodes(one) for key, one in expected.by_numbers().items())
        assert [one.time for one in each.finished] == sorted(one.time for one in each.finished)
        assert all(np.array_equal(getattr(each.episodes(), a), getattr(recording.episodes(), a)) for a in ARRAYS)


def test_a_vetoed_episode_without_a_repetition_is_discarded(cut: Path) -> None:
    recording = read_recording(cut)
    last = Batch(TRAINING.seed, 3, 1, TRAINING.horizon, explore=True)
    assert [each.batch for each in recording.batches[-2:]] == [last, last]
    assert [each.is_discarded for each in recording.batches[-2:]] == [False, True]
    for each in (recording, *shuffles(recording)):
        assert last not in each.by_numbers()
        assert len(each.finished) == STOPPED_AFTER - 1
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


@pytest.mark.parametrize("order", ORDERS)
def test_a_run_with_vetoes_replays(whole: Path, cut: Path, order: str) -> None:
    assert len(list(replay(read_recording(ordered(whole, order))))) == 4
    assert len(list(replay(read_recording(ordered(cut, order))))) == 1


@pytest.mark.parametrize("order", ORDERS)
def test_vetoed_episodes_are_not_exported(whole: Path, cut: Path, order: str, rkhs: Callable[..., Result]) -> None:
    parquet = pytest.importorskip("pyarrow.parquet")
    for file, count in ((whole, 20), (cut, STOPPED_AFTER - 1)):
        out = f"out{count}"
        assert rkhs("export", ordered(file, order), "--lerobot", out).out.startswith(f"Exported {count} episodes")
        frames = parquet.read_table(f"{out}/data/chunk-000/file-000.parquet").to_pydict()
        assert min(frames["next.reward"]) >= 0


@pytest.mark.parametrize("order", ORDERS)
def test_offline_training_ignores_vetoed_episodes(
    whole: Path, cut: Path, order: str, rkhs: Callable[..., Result]
) -> None:
    for name, file, count in (("whole", whole, 20), ("cut", cut, STOPPED_AFTER - 1)):
        learnt = rkhs("offline", ordered(file, order), *SHORT, "--out", name)
        assert learnt.code == 0, learnt.err
        assert f"from {count} recorded episodes" in learnt.out
        assert rkhs("offline", file, *SHORT, "--out", f"{name}_again").code == 0
        assert Path(name, "policy.npz").read_bytes() == Path(f"{name}_again", "policy.npz").read_bytes()


@pytest.mark.parametrize("order", ORDERS)
def test_vetoed_episodes_are_not_viewed(whole: Path, never_vetoed: Path, order: str) -> None:
    pytest.importorskip("viser")
    from rkhs_ros.view.recorded import Recorded

    run, expected = Recorded(ordered(whole, order)), Recorded(never_vetoed)
    for number in expected.iterations:
        viewed, right = run.load(number), expected.load(number)
        for kind in ("exploration", "evaluation"):
            got, wanted = (getattr(each, kind).rewards for each in (viewed, right))
            assert np.array_equal(np.sort(got, axis=0), np.sort(wanted, axis=0))  # repeated episodes come last


@pytest.mark.parametrize("plugin", list(StoragePlugin))
def test_a_veto_in_a_bag_discards_the_episode_in_any_order(cut: Path, tmp_path: Path, plugin: StoragePlugin) -> None:
    recording = read_recording(cut)
    batches = recording.batches
    for name, each in {"later": recording, "first": replace(recording, batches=[batches[-1], *batches[:-1]])}.items():
        folder = bag(tmp_path / name, each, plugin=plugin)
        read = read_recording(folder)
        assert read.by_numbers().keys() == recording.by_numbers().keys()
        assert read.episodes().rewards.min() >= 0


class TestTwoRunsInOneBag:
    def test_runs_with_different_seeds_in_a_bag_are_all_read(
        self, tmp_path: Path, rkhs: Callable[..., Result], capsys: pytest.CaptureFixture[str]
    ) -> None:
        runs = [recorded_run(tmp_path / f"seed_{seed}", longer(2, seed=seed)) for seed in (0, 5)]
        recordings = [read_recording(run) for run in runs]
        read = read_recording(bag(tmp_path / "bag", *recordings))
        assert len(read.episodes()) == sum(len(each.episodes()) for each in recordings) == 20
        assert {each.batch.seed for each in read.finished} == {0, 5}
        assert capsys.readouterr().err == ""
        learnt = rkhs("offline", tmp_path / "bag", runs[0].parent / "config.yaml", *SHORT, "--out", "learnt")
        assert "from 20 recorded episodes" in learnt.out

    def test_of_runs_with_the_same_seed_the_later_is_read_with_a_warning(
        self, tmp_path: Path, capsys: pytest.CaptureFixture[str]
    ) -> None:
        changes = ({}, {"episodes_per_iteration": 2})
        first, later = (
            read_recording(recorded_run(tmp_path / f"run_{k}", longer(1, **change))) for k, change in enumerate(changes)
        )
        others = [
            each._replace(episodes=replace(each.episodes, rewards=each.episodes.rewards + 1.0))
            for each in later.batches
        ]
        folder = bag(tmp_path / "bag", first, replace(later, batches=others))
        read = read_recording(folder)
        assert len(read.finished) == 3 + 2
        assert capsys.readouterr().err == (
            f"warning: {folder}: ignored 4 episodes, since later ones have the same seeds and numbers. "
            "Record runs with the same seed in separate bags.\n"
        )

    def test_a_run_recorded_twice_gives_no_warning(
        self, whole: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
    ) -> None:
        recording = read_recording(whole)
        assert len(read_recording(bag(tmp_path / "bag", recording, recording)).finished) == 20
        assert capsys.readouterr().err == ""
