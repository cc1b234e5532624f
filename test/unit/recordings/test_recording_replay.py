import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from rkhs_ros.recordings.container import MessageFile, MessageReader, Stored
from rkhs_ros.recordings.definitions import decoded, encoded
from rkhs_ros.recordings.recording import read_recording
from rkhs_ros.runs.config import Config, load_config
from rkhs_ros.runs.replay import DifferenceError, replay
from rkhs_ros.runs.report import start_from
from test.unit.conftest import Result, assert_refused
from test.unit.recordings.recorded_runs import longer, recorded_run

pytestmark = pytest.mark.usefixtures("quick_disk")
ROOT = Path(__file__).parents[3]


def config(name: str, *changes: str) -> Config:
    return load_config(ROOT / "config" / f"{name}.yaml", changes)


def changed(file: Path, kind: str, place: int, change: Callable[[Any], None]) -> Path:
    """Rewrite a recording with a changed message, given by type and index, and a correct checksum."""
    messages: list[Stored] = MessageReader(file).news().messages
    places = [i for i, stored in enumerate(messages) if stored.kind.endswith(f"/{kind}")]
    old = messages[places[place]]
    message = decoded(memoryview(bytearray(old.content)), old.kind, old.definition)  # in writable memory
    change(message)
    messages[places[place]] = old._replace(content=encoded(message))
    copy = file.with_name("changed.mcap")
    MessageFile(copy, messages).close()
    return copy


def flip(values: np.ndarray, place: int) -> None:
    values.view(np.uint64)[place] ^= 1


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return recorded_run(tmp_path_factory.mktemp("whole") / "run")


@pytest.mark.parametrize(
    "run",
    [
        config("toy_nac", "iterations=10"),  # 100 exploration episodes
        config("toy_nac", "name=toy_npg", "iterations=3", "algorithm={name: rkhs_npg, centres: 20}"),
        config("toy_ac", "iterations=3", "algorithm.step={rule: line_search}"),
        config("toy_power", "iterations=4", "evaluate_every=3"),
        config("pendulum_pomdp_power", "iterations=2", "horizon=20"),
        config("pendulum_model_nac", "iterations=3", "horizon=30", "model.updates=3", "model.rollouts=10"),
        config("pendulum_nac", "iterations=3", "horizon=60", "action_repeat=4", "inputs.history=2"),
    ],
    ids=lambda run: run.training.name,
)
def test_a_recording_replays_bit_identically(run: Config, tmp_path: Path) -> None:
    recording = read_recording(recorded_run(tmp_path / "run", run))
    again = list(replay(recording))
    assert len(again) == run.training.iterations == len(recording.updates)
    explored = sum(batch.batch.num_envs for batch in recording.batches if batch.batch.explore)
    assert explored == again[-1].episodes_used
    assert again[-1].episodes_used >= 100 or run.training.name != "toy_nac"


def test_a_run_with_an_initial_policy_replays(whole: Path, tmp_path: Path) -> None:
    (tmp_path / "run").mkdir()
    given = read_recording(whole)
    config = longer(2, seed=9)
    start_from(tmp_path / "run", config, given.policies[3], given.head.spaces)
    recording = read_recording(recorded_run(tmp_path / "run", config))
    assert len(recording.policies[1].mean.centres) > 0
    assert len(list(replay(recording))) == 2


def test_a_recording_that_lacks_finished_updates_is_reported(
    whole: Path, tmp_path: Path, rkhs: Callable[..., Result]
) -> None:
    folder = shutil.copytree(whole.parent, tmp_path / "run")
    messages: list[Stored] = MessageReader(whole).news().messages
    second = [i for i, stored in enumerate(messages) if stored.kind.endswith("/Update")][1]
    MessageFile(folder / whole.name, messages[: second + 1]).close()
    expected = "the first 2 of 4 updates are bit-identical; the recording lacks the others\n"
    assert rkhs("replay", folder, "--quiet") == (1, expected, "")


EXPLORING, EVALUATION = 2, 3  # indices of the second update's batches


@pytest.mark.parametrize("name", ["observations", "actions", "rewards"])
@pytest.mark.parametrize(("place", "kind"), [(EXPLORING, "exploration"), (EVALUATION, "evaluation")])
def test_a_flipped_bit_in_an_episode_is_detected(whole: Path, name: str, place: int, kind: str) -> None:
    copy = changed(whole, "RecordedEpisodes", place, lambda message: flip(getattr(message.episodes, name), 6))
    with pytest.raises(DifferenceError, match=r"^update 2, ") as found:
        list(replay(read_recording(copy)))
    if name == "actions":
        assert f"update 2, {kind} environment 0 (episode" in str(found.value)


@pytest.mark.parametrize(
    ("change", "where"),
    [
        (lambda policy: flip(policy.weights, 1), r"policy 2, weights\[\d, \d\]: recorded .*, recomputed "),
        (lambda policy: flip(policy.variance.values, 0), r"policy 2, variance\[0\]: "),
        (lambda policy: flip(policy.kernel[0].parameters, 0), r"policy 2, kernel_parameters\[0\]: "),
    ],
)
def test_a_flipped_bit_in_a_policy_is_detected(whole: Path, change: Callable[[Any], None], where: str) -> None:
    copy = changed(whole, "Policy", 1, change)
    with pytest.raises(DifferenceError, match="^update 1, evaluation episode 0: " + where):
        list(replay(read_recording(copy)))


@pytest.mark.parametrize("name", ["kl", "exploration_return"])
def test_a_flipped_bit_in_an_update_is_detected(whole: Path, name: str) -> None:
    def change(update: Any) -> None:
        setattr(update, name, float(np.nextafter(getattr(update, name), np.inf)))

    copy = changed(whole, "Update", 2, change)
    with pytest.raises(DifferenceError, match=f"^update 3, {name}: recorded .*, recomputed "):
        list(replay(read_recording(copy)))


def test_replay_reports_equal_and_different_updates(whole: Path, rkhs: Callable[..., Result]) -> None:
    assert rkhs("replay", whole.parent, "--quiet") == (0, "all 4 updates are bit-identical\n", "")
    copy = changed(whole, "Update", 2, lambda update: setattr(update, "kl", 0.5))
    result = rkhs("replay", copy, "--quiet")
    assert (result.code, result.err) == (1, "")
    assert result.out.startswith("update 3, kl: recorded 0.5, recomputed ")
    assert result.out.endswith("; the first 2 of 4 updates are bit-identical\n")


def test_replay_rejects_recordings_without_updates(whole: Path, tmp_path: Path, rkhs: Callable[..., Result]) -> None:
    assert_refused(rkhs("replay", tmp_path / "none.mcap"), "none.mcap: no such recording")
    messages = [message for message in MessageReader(whole).news().messages if not message.kind.endswith("/Update")]
    MessageFile(tmp_path / "a.mcap", messages).close()
    assert_refused(rkhs("replay", tmp_path / "a.mcap"), "expected the recording of a run with updates, got no updates")
