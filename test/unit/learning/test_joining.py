"""Concatenating many episodes copies each one only a few times."""

from pathlib import Path

import pytest

from rkhs_ros.learning.episodes import Episodes
from rkhs_ros.policies.streams import Batch
from rkhs_ros.recordings.recorder import Recorder
from rkhs_ros.recordings.recording import read_recording
from rkhs_ros.runs.offline import all_episodes
from rkhs_ros.runs.recorded import RecordingRunner
from rkhs_ros.runs.replay import RecordedRunner
from test.unit.recordings.recorded_runs import Robot, longer, recorded_run

pytestmark = pytest.mark.usefixtures("quick_disk")
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
