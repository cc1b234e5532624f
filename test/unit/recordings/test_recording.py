import resource
import signal
from contextlib import suppress
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory

from rkhs_ros.learning.episodes import Episodes
from rkhs_ros.policies.messages import policy_message, policy_of
from rkhs_ros.policies.streams import Batch
from rkhs_ros.recordings.container import MessageFile, MessageReader, Stored
from rkhs_ros.recordings.definitions import FOLDER, Types, decoded, definition, encoded
from rkhs_ros.recordings.recorder import Recorder, read_held
from rkhs_ros.recordings.recording import read_recording
from rkhs_ros.runs.offline import all_episodes
from rkhs_ros.runs.recorded import RecordingRunner
from rkhs_ros.runs.replay import RecordedRunner
from rkhs_ros.view.recorded import Recorded
from test.unit.conftest import random_policy
from test.unit.recordings.recorded_runs import CONFIG, Robot, content, longer, recorded_run

pytestmark = pytest.mark.usefixtures("quick_disk")
ROOT = Path(__file__).parents[3]
KIND = "rkhs_interfaces/msg/Action"


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return recorded_run(tmp_path_factory.mktemp("whole") / "run")


def noted(texts: list[str]) -> list[Stored]:
    contents = [encoded(Types().Action(failure=text)) for text in texts]
    return [Stored("noted", KIND, definition(KIND), each, 10 + i, i) for i, each in enumerate(contents)]


def test_definitions_match_rkhs_interfaces() -> None:
    assert FOLDER.resolve() == (ROOT / "rkhs_interfaces" / "msg").resolve()
    listed = (ROOT / "rkhs_interfaces" / "CMakeLists.txt").read_text()
    assert len(list(FOLDER.glob("*.msg"))) > 10
    for path in FOLDER.glob("*.msg"):
        assert f"msg/{path.name}\n" in listed
        message = getattr(Types(), path.stem)()
        if "Time" not in path.read_text():  # of builtin_interfaces
            kind = f"rkhs_interfaces/msg/{path.stem}"
            assert encoded(decoded(encoded(message), kind, definition(kind))) == encoded(message)


def test_the_noise_of_a_policy_is_recorded(rng: np.random.Generator) -> None:
    message = policy_message(Types(), replace(random_policy(rng), noise="pink"), 7)
    kind = "rkhs_interfaces/msg/Policy"
    assert policy_of(decoded(encoded(message), kind, definition(kind))).noise == "pink"


def test_an_independent_reader_gets_the_same_values(whole: Path) -> None:
    recording = read_recording(whole)
    with whole.open("rb") as file:
        reader = make_reader(file, validate_crcs=True, decoder_factories=[DecoderFactory()])
        read = [(channel.topic, message) for _, channel, _, message in reader.iter_decoded_messages()]
        statistics = reader.get_summary().statistics
    assert statistics.message_count == len(read) == len(MessageReader(whole).news().messages)
    batches = [message for topic, message in read if topic == "recorded_episodes"]
    assert len(batches) == len(recording.batches) == 8
    for mine, other in zip(recording.batches, batches, strict=True):
        assert (mine.batch.first_episode, mine.batch.explore) == (other.first_episode, other.explore)
        for name in ("observations", "actions", "rewards", "final_observations"):
            assert getattr(mine.episodes, name).ravel().tolist() == list(getattr(other.episodes, name))
        assert mine.episodes.mask.sum(axis=1).tolist() == list(other.episodes.lengths)
    policies = {message.version: message for topic, message in read if topic == "policy"}
    for version, policy in recording.policies.items():
        assert policy.mean.weights.ravel().tolist() == list(policies[version].weights)
    task = next(message for topic, message in read if topic == "task")
    assert (task.environment, task.seed, task.horizon) == ("rkhs/Toy-v0", 0, 5)
    assert (whole.parent / "config.yaml").read_text() == task.configuration


def test_a_truncated_file_is_read_up_to_the_last_complete_record(
    whole: Path, tmp_path: Path, rng: np.random.Generator, capsys: pytest.CaptureFixture[str]
) -> None:
    content = whole.read_bytes()
    everything = MessageReader(whole).news()
    assert everything.faults == []
    ends = [content.index(message.content) + len(message.content) for message in everything.messages]
    cut = tmp_path / "cut.mcap"
    for size in sorted(rng.integers(len(b"magic..."), len(content), 50)):
        cut.write_bytes(content[:size])
        found = MessageReader(cut).news()
        expected = sum(end <= size for end in ends)
        assert found.messages == everything.messages[:expected]
        assert len(found.faults) == (size < content.index(everything.messages[-1].content) + 1000) or not found.faults
    cut.write_bytes(content[: ends[6] - 1])
    recording = read_recording(cut)
    assert sum(map(len, (recording.batches, recording.policies, recording.updates))) == 5
    line = capsys.readouterr().err
    assert line.startswith(f"warning: {cut}: incomplete after 6 messages: ")
    assert line.count("\n") == 1


def loaded(path: Path) -> None:
    source = Recorded(path)
    for iteration in source.iterations:
        source.load(iteration)


def test_a_flipped_bit_is_always_detected(whole: Path, tmp_path: Path, rng: np.random.Generator) -> None:
    content, everything = bytearray(whole.read_bytes()), MessageReader(whole).news().messages
    damaged, lost = tmp_path / "damaged.mcap", 0
    for at, bit in zip(rng.integers(8, len(content), 200), rng.integers(0, 8, 200), strict=True):
        content[at] ^= 1 << bit
        damaged.write_bytes(content)
        found = MessageReader(damaged).news()
        assert [message for message in found.messages if message not in everything] == []
        assert len(found.messages) == len(everything) or found.faults
        for read in (read_recording, partial(read_held, iterations=4, keeps_later=True), loaded):
            with suppress(ValueError, OSError):  # of one line
                read(damaged)
        lost += len(found.messages) < len(everything)
        content[at] ^= 1 << bit
    assert 100 < lost < 200


def test_a_file_that_continues_with_a_newer_definition_keeps_the_older_messages(tmp_path: Path) -> None:
    (new,) = noted(["new"])
    old = new._replace(definition="uint32 number", content=b"\0\1\0\0\7\0\0\0")
    MessageFile(tmp_path / "a.mcap", [old, new]).close()
    assert MessageReader(tmp_path / "a.mcap").news().messages == [old, new]


def test_a_full_disk_preserves_earlier_messages(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    file = MessageFile(path, noted(["a", "b"]))
    size = path.stat().st_size
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    handler = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    try:
        resource.setrlimit(resource.RLIMIT_FSIZE, (size + 50, hard))
        with pytest.raises(OSError, match=r"a\.mcap"):
            file.write(noted(["c" * 1000])[0])
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
        signal.signal(signal.SIGXFSZ, handler)
    file.close()
    assert MessageReader(path).news().messages == noted(["a", "b"])
    assert path.stat().st_size == size


def test_the_recording_of_a_robot_is_synced_before_the_learner_continues(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    synced: list[int] = []
    monkeypatch.setattr("os.fsync", lambda descriptor: synced.append(descriptor))
    file = MessageFile(tmp_path / "a.mcap", sync=True)
    for message in noted(["a", "b"]):
        before = len(synced)
        file.write(message)
        assert len(synced) == before + 1
    file.close()


@pytest.mark.parametrize("episodes", [1, 5, 7, 14])
def test_an_interrupted_run_on_a_robot_repeats_no_episode(
    tmp_path: Path, episodes: int, capsys: pytest.CaptureFixture[str]
) -> None:
    never_stopped = read_recording(recorded_run(tmp_path / "whole", runner=Robot()))
    stopped, goes_on = Robot(episodes), Robot()
    with pytest.raises(KeyboardInterrupt):
        recorded_run(tmp_path / "run", runner=stopped)
    file = recorded_run(tmp_path / "run", runner=goes_on, resume=True)
    assert not (tmp_path / "run" / "final_evaluation.txt").exists()  # a robot's episodes are costly
    assert len(stopped.moved) == episodes
    assert len(set(stopped.moved + goes_on.moved)) == len(stopped.moved) + len(goes_on.moved) == 20
    assert content(read_recording(file)) == content(never_stopped)
    assert "warning" not in capsys.readouterr().err


def test_a_discarded_episode_is_recorded_but_not_used(tmp_path: Path) -> None:
    recording = read_recording(recorded_run(tmp_path / "run", runner=Robot()))
    discarded = [batch for batch in recording.batches if batch.is_discarded]
    assert {batch.executions[0].discard_reason for batch in discarded} == {"stopped"}
    assert len(recording.batches) == len(recording.by_numbers().values()) + len(discarded) == 20 + 7
    assert len(recording.episodes()) == 20
    assert recording.episodes().rewards.min() >= 0
    first = recording.batches[0]
    assert np.diff(first.executions[0].stamps).tolist() == [50_000_000] * 5
    assert first.executions[0].executed.shape == (5, 2)
    assert first.executions[0].flags.tolist() == [0, 1, 2, 3, 4]
    messages = MessageReader(tmp_path / "run" / "recording.mcap").news().messages
    assert next(m.published for m in messages if "Recorded" in m.kind) == first.executions[0].stamps[-1]


def test_what_follows_the_last_update_is_cut_off(whole: Path, tmp_path: Path) -> None:
    file = recorded_run(tmp_path / "run", longer(2))
    later = [each for each in MessageReader(whole).news().messages if not each.kind.endswith(("/Task", "/Update"))]
    held = MessageReader(file).news().messages
    MessageFile(file, [*held, *later]).close()
    recorded_run(tmp_path / "run", CONFIG, resume=True)
    assert content(read_recording(file)) == content(read_recording(whole))


def test_the_recording_of_another_run_is_rejected(whole: Path, tmp_path: Path) -> None:
    other = replace(CONFIG, training=replace(CONFIG.training, seed=1))
    recorded_run(tmp_path / "other", other)
    (tmp_path / "other" / "recording.mcap").write_bytes(whole.read_bytes())
    before = {path: path.read_bytes() for path in (tmp_path / "other").rglob("*") if path.is_file()}
    with pytest.raises(ValueError, match=r"seed: expected 0 as at the start of the run, got 1"):
        recorded_run(tmp_path / "other", longer(6, seed=1), resume=True)
    assert {path: path.read_bytes() for path in (tmp_path / "other").rglob("*") if path.is_file()} == before


def test_invalid_recordings_are_rejected(tmp_path: Path) -> None:
    (tmp_path / "a.mcap").write_bytes(b"no such thing")
    with pytest.raises(ValueError, match=r"a\.mcap: expected an MCAP file"):
        read_recording(tmp_path / "a.mcap")
    with pytest.raises(FileNotFoundError, match=r"no recording\.mcap in this folder"):
        read_recording(tmp_path)
    MessageFile(tmp_path / "b.mcap", noted(["a"])).close()
    with pytest.raises(ValueError, match=r"b\.mcap: expected a recording of a run"):
        read_recording(tmp_path / "b.mcap")


EPISODES = 120
MOST_COPIES = 6  # of an episode; repeated addition would copy each one EPISODES / 2 times on average


@pytest.fixture(scope="module")
def file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    config = longer(1, episodes_per_iteration=EPISODES, evaluate_every=0)
    return recorded_run(tmp_path_factory.mktemp("many") / "run", config, Robot(discard_every=10**6))


@pytest.mark.parametrize("user", ["recording", "offline", "resume", "replay", "rollout", "view"])
def test_joining_is_linear(file: Path, user: str, monkeypatch: pytest.MonkeyPatch) -> None:
    recording = read_recording(file)
    policy, robot = recording.policies[1], Robot(discard_every=10**6)
    recorder = Recorder(None, recording)  # type: ignore[arg-type] # nothing is written
    batch = Batch(0, 0, EPISODES, 5, explore=True)

    users = {
        "recording": recording.episodes,
        "offline": lambda: all_episodes({"a": recording}),
        "resume": lambda: RecordingRunner(robot, recorder, file, recording.by_numbers()).collect(policy, batch),
        "replay": lambda: RecordedRunner(recording, robot.spaces).collect(policy, batch),
        "rollout": lambda: robot.runner.collect(policy, batch),
        "view": lambda: recording.exploration(1),
    }
    sizes: list[int] = []
    made = Episodes.__post_init__
    monkeypatch.setattr(Episodes, "__post_init__", lambda episodes: (sizes.append(len(episodes)), made(episodes))[1])
    found = users[user]()
    assert found is not None
    assert len(found) == EPISODES
    assert EPISODES <= sum(sizes) <= MOST_COPIES * EPISODES
