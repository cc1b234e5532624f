"""Offline training from recordings, and their export."""

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from rkhs_ros.policies.storage import load_policy
from rkhs_ros.recordings.recording import read_recording
from rkhs_ros.runs.config import Config, load_config
from test.unit.conftest import Result, assert_refused
from test.unit.recordings.recorded_runs import CONFIG, Robot, longer, recorded_run

pytestmark = pytest.mark.usefixtures("quick_disk")
ROOT = Path(__file__).parents[3]
EXPLORE = ("model.updates=1", "model.rollouts=2", "evaluate_every=0", "iterations=1")


def exploring(episodes: int, *changes: str) -> Config:
    """Record a run whose initial policy acts in all episodes."""
    settings = (*EXPLORE, f"episodes_per_iteration={episodes}", *changes)
    return load_config(ROOT / "config" / "pendulum_wrap_model_nac.yaml", settings)


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return recorded_run(tmp_path_factory.mktemp("whole") / "run")


@pytest.fixture(scope="module")
def of_a_robot(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return recorded_run(tmp_path_factory.mktemp("robot") / "run", runner=Robot())


@pytest.mark.nightly
@pytest.mark.parametrize("seed", [3, 0])  # the worst of ten seeds, all of which reach 45, and a good one
def test_offline_training_solves_the_pendulum_from_ten_exploration_episodes(
    tmp_path: Path, rkhs: Callable[..., Result], seed: int
) -> None:
    recorded_run(tmp_path / f"explored{seed}", exploring(10, f"seed={seed}"))
    assert len(read_recording(tmp_path / f"explored{seed}").episodes()) == 10
    out = tmp_path / f"learnt{seed}"
    config = ROOT / "config/pendulum_wrap_model_nac.yaml"
    learnt = rkhs("offline", f"explored{seed}", config, "--seed", seed, "--out", out, "--quiet")
    assert learnt.code == 0, learnt.err
    assert "from 10 recorded episodes, without running new ones" in learnt.out
    assert json.loads(rkhs("evaluate", out).out)["mean"] > 45  # of 51.8


SHORT = ("--iterations", 2, "--set", "model.updates=2", "model.rollouts=5", "--quiet")


def test_an_offline_policy_is_evaluated_and_trained_further(whole: Path, rkhs: Callable[..., Result]) -> None:
    done = rkhs("offline", whole, *SHORT, "--out", "learnt")
    assert (done.code, done.err) == (0, "")
    made = {path.name for path in Path("learnt").iterdir()}
    assert {"policy.npz", "best_policy.npz", "config.yaml", "curve.csv", "curve.png", "policy.png"} <= made
    assert rkhs("evaluate", "learnt", "--episodes", 2).code == 0
    policy, task = load_policy(Path("learnt/policy.npz"))
    assert task == CONFIG.task
    began = rkhs(
        "train", whole.parent / "config.yaml", "--policy", "learnt/policy.npz", "--runner", "inline", "--iterations", 1,
        "--quiet", "--out", "on",
    )  # fmt: skip
    assert began.code == 0
    assert np.array_equal(read_recording(Path("on")).policies[1].mean.weights, policy.mean.weights)


def test_an_offline_run_is_viewed_and_imitated(whole: Path, rkhs: Callable[..., Result]) -> None:
    pytest.importorskip("viser")
    from rkhs_ros.view.recorded import Recorded

    assert rkhs("offline", whole, *SHORT, "--set", "horizon=3", "--out", "learnt").code == 0
    source, given = Recorded(Path("learnt")), read_recording(whole).episodes()
    assert len(source.rows) == len(source.iterations) == 2
    first, last = source.load(1), source.load(2)
    assert np.array_equal(first.exploration.rewards, given.rewards)
    weights = load_policy(Path("learnt/policy.npz"))[0].mean.weights
    assert np.array_equal(last.policy.mean.weights, weights)
    assert len(last.roll_out_model()) > 0
    assert rkhs("export", "learnt", "page.html").code == 0
    assert "Fitted 5 centres to 20 episodes" in rkhs("imitate", "learnt", "--set", "centres=5").out
    assert_refused(rkhs("replay", "learnt", "--quiet"), "got that of an offline run")


def test_offline_training_is_a_function_of_the_recordings(whole: Path, rkhs: Callable[..., Result]) -> None:
    other = recorded_run(Path("other"), longer(2, seed=5))
    for name, recordings in {"a": [whole], "b": [whole.parent], "c": [whole, other]}.items():
        assert rkhs("offline", *recordings, *SHORT, "--out", name).code == 0
    a, b, c = (Path(name, "policy.npz").read_bytes() for name in "abc")
    assert a == b != c
    assert f"from {20 + 10} recorded episodes" in rkhs("offline", whole, other, *SHORT, "--out", "d").out


def test_recordings_of_different_tasks_are_rejected(whole: Path, rkhs: Callable[..., Result]) -> None:
    other = recorded_run(Path("other"), longer(1, horizon=7))
    assert_refused(rkhs("offline", whole, other, *SHORT), "other/recording.mcap: task: expected the task of")
    pendulum = ROOT / "config" / "pendulum_nac.yaml"
    assert_refused(rkhs("offline", whole, pendulum), "pendulum_nac.yaml: environment: expected the environment of")
    assert_refused(rkhs("offline", pendulum), "offline: expected at least one recording, got none")
    assert_refused(rkhs("offline", whole, whole.parent), "offline: expected each recording once, got")
    changed = rkhs("offline", whole, "--set", "environment.id=rkhs/Pendulum-v0")
    assert_refused(changed, "--set: expected no settings of the environment, got some")


def test_held_actions_are_imitated_trained_offline_and_exported(tmp_path: Path, rkhs: Callable[..., Result]) -> None:
    pytest.importorskip("pyarrow")
    from pyarrow import parquet

    small = ("iterations=2", "episodes_per_iteration=4", "evaluation_episodes=1", "horizon=200", "seed=1")
    held = ("action_repeat=auto", "exploration_sd=[1.0]")
    config = load_config(ROOT / "config" / "pendulum_nac.yaml", (*small, *held))
    run = recorded_run(tmp_path / "run", config).parent
    repeat = load_policy(run / "policy.npz")[0].action_repeat
    assert repeat > 1
    for shown in (run, run / "recording.mcap"):
        done = rkhs("imitate", shown, "--set", "centres=5", "--out", "shown.npz")
        assert (done.code, done.err) == (0, "")
        assert load_policy(Path("shown.npz"))[0].action_repeat == repeat
    done = rkhs("offline", run, *SHORT, "--out", "learnt")
    assert (done.code, done.err) == (0, "")
    assert load_policy(Path("learnt/policy.npz"))[0].action_repeat == repeat
    assert load_config(Path("learnt/config.yaml")).training.action_repeat == repeat
    assert rkhs("export", run, "--lerobot", "out", "--fps", 10).code == 0
    actions = np.array(parquet.read_table("out/data/chunk-000/file-000.parquet")["action"].to_pylist())
    last = actions[-200:].reshape(-1, repeat)
    assert (last == last[:, :1]).all()
    assert len(np.unique(last)) == 200 // repeat


def test_the_lerobot_export_has_the_values_of_the_recording(of_a_robot: Path, rkhs: Callable[..., Result]) -> None:
    parquet = pytest.importorskip("pyarrow.parquet")
    done = rkhs("export", of_a_robot, "--lerobot", "out", "--task", "reach")
    assert done.out == "Exported 20 episodes at 20 steps per second: out\n"
    table = parquet.read_table("out/data/chunk-000/file-000.parquet")
    frames, finished = table.to_pydict(), list(read_recording(of_a_robot).by_numbers().values())
    for column, name in (("observation.state", "observations"), ("action", "actions"), ("next.reward", "rewards")):
        expected = np.concatenate([getattr(each.episodes, name)[0] for each in finished]).astype(np.float32)
        assert np.array_equal(np.array(frames[column], dtype=np.float32).reshape(expected.shape), expected)
    assert frames["action.executed"][0] == [0.5, 0.5]
    assert frames["frame_index"] == list(range(5)) * 20
    assert frames["index"] == list(range(100))
    assert np.allclose(frames["timestamp"], np.tile(0.05 * np.arange(5), 20))
    assert frames["next.done"] == [False, False, False, False, True] * 20
    info, stats = (json.loads(Path("out/meta", name).read_text()) for name in ("info.json", "stats.json"))
    assert (info["codebase_version"], info["fps"], info["total_frames"]) == ("v3.0", 20, 100)
    assert set(info["features"]) == set(table.column_names) == set(stats)
    rewards = np.array(table["next.reward"])
    assert np.isclose(stats["next.reward"]["mean"][0], rewards.mean())
    assert stats["next.reward"]["count"] == [100]
    episodes = parquet.read_table("out/meta/episodes/chunk-000/file-000.parquet").to_pylist()
    assert [(e["dataset_from_index"], e["dataset_to_index"]) for e in episodes[:2]] == [(0, 5), (5, 10)]
    assert episodes[7]["tasks"] == ["reach"]
    assert np.isclose(episodes[1]["stats/next.reward/max"][0], rewards[5:10].max())
    tasks = parquet.read_table("out/meta/tasks.parquet")
    assert json.loads(tasks.schema.metadata[b"pandas"])["index_columns"] == ["__index_level_0__"]
    assert tasks.to_pydict() == {"task_index": [0], "__index_level_0__": ["reach"]}


def test_a_simulation_or_a_fractional_rate_requires_fps(whole: Path, rkhs: Callable[..., Result]) -> None:
    parquet = pytest.importorskip("pyarrow.parquet")
    assert_refused(rkhs("export", whole, "--lerobot", "out"), "--fps: expected the steps per second")
    slow = recorded_run(Path("run"), longer(1), Robot(period=400_000_000))
    assert_refused(rkhs("export", slow, "--lerobot", "out"), "got 2.5 from the time stamps. Use --fps N")
    assert not Path("out").exists()
    assert rkhs("export", slow, "--lerobot", "out", "--fps", 4).out.startswith("Exported 5 episodes at 4 steps per s")
    times = parquet.read_table("out/data/chunk-000/file-000.parquet")["timestamp"].to_pylist()
    assert times[:5] == [0.0, 0.25, 0.5, 0.75, 1.0]
    assert_refused(rkhs("export", whole, "--lerobot", "out", "--fps", 10), "out: expected a new folder")
