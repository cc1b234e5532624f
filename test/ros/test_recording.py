"""A run over topics records the same episodes, policies and updates as one in process."""

from collections import Counter
from collections.abc import Callable
from pathlib import Path

from rkhs_ros.recordings.container import read_messages
from rkhs_ros.recordings.recording import read_recording
from test.ros.conftest import ROOT, Process
from test.unit.recorded_runs import content, same_batch

SHORT = ("--iterations", 3, "--set", "episodes_per_iteration=4", "horizon=10", "timeout=60", "--quiet", "--record")


def test_the_same_is_recorded_over_topics_as_in_process(start: Callable[..., Process], tmp_path: Path) -> None:
    arguments = ("train", ROOT / "config" / "toy_nac.yaml", *SHORT)
    runs = {
        runner: start("rkhs", *arguments, *more, "--runner", runner, "--out", tmp_path / runner)
        for runner, more in {"ros": ("--simulators", 1), "inline": ()}.items()
    }
    assert [run.finish()[0] for run in runs.values()] == [0, 0]
    over_topics, in_process = (read_recording(tmp_path / runner) for runner in runs)
    assert content(over_topics) == content(in_process)
    assert len(over_topics.batches) == 6
    assert over_topics.head is not None
    assert in_process.head is not None
    assert over_topics.head.task == in_process.head.task


def test_all_topics_are_recorded_beside_it(start: Callable[..., Process], tmp_path: Path) -> None:
    arguments = ("train", ROOT / "config" / "toy_nac.yaml", *SHORT, "raw", "--runner", "ros", "--out", tmp_path / "run")
    assert start("rkhs", *arguments).finish()[0] == 0
    heard = Counter(message.topic for message in read_messages(tmp_path / "run" / "raw.mcap").messages)
    assert 20 <= heard["/action"] <= 6 * 10  # it may begin a little late
    assert 20 <= heard["/observation"] <= 6 * 11
    assert heard["/diagnostics"] > 0
    raw, learnt_from = (read_recording(tmp_path / "run" / name) for name in ("raw.mcap", "recording.mcap"))
    assert len(raw.batches) >= 2
    for one, other in zip(raw.batches, learnt_from.batches[-len(raw.batches) :], strict=True):
        assert same_batch(one, other)
