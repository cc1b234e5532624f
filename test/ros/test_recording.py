"""A run over topics records the same episodes, policies and updates as one in process."""

from collections import Counter
from collections.abc import Callable
from pathlib import Path

import pytest

from rkhs_ros.recordings.container import read_messages
from rkhs_ros.recordings.recording import read_recording
from test.ros.conftest import ROOT, Process
from test.unit.recordings.recorded_runs import content, same_batch

SHORT = ("--iterations", 3, "--set", "episodes_per_iteration=4", "horizon=10", "timeout=60", "--quiet")


@pytest.mark.nightly
def test_recordings_over_topics_equal_those_in_process(start: Callable[..., Process], tmp_path: Path) -> None:
    arguments = ("train", ROOT / "config" / "toy_nac.yaml", *SHORT)
    runs = {
        runner: start("rkhs", *arguments, "--runner", runner, "--out", tmp_path / runner)
        for runner in ("ros", "inline")
    }
    assert [run.finish()[0] for run in runs.values()] == [0, 0]
    over_topics, in_process = (read_recording(tmp_path / runner) for runner in runs)
    assert content(over_topics) == content(in_process)
    assert len(over_topics.batches) == 6
    assert over_topics.head is not None
    assert in_process.head is not None
    assert over_topics.head.task == in_process.head.task


@pytest.mark.nightly
def test_all_topics_can_be_recorded_as_well(start: Callable[..., Process], tmp_path: Path) -> None:
    more = ("--record-topics", "--runner", "ros", "--out", tmp_path / "run", "--iterations", 40)  # it may begin late
    assert start("rkhs", "train", ROOT / "config" / "toy_nac.yaml", *SHORT, *more).finish()[0] == 0
    found = read_messages(tmp_path / "run" / "raw.mcap")
    heard = Counter(message.topic for message in found.messages)
    assert found.faults == []
    assert all(heard[topic] > 20 for topic in ("/observation", "/action"))  # more where a batch began anew
    assert heard["/diagnostics"] > 0
    raw, learnt_from = (read_recording(tmp_path / "run" / name).batches for name in ("raw.mcap", "recording.mcap"))
    episodes = {(each.batch.explore, each.batch.first_episode): each for each in learnt_from}
    both = [each for each in raw if each.batch.seed == learnt_from[0].batch.seed]  # without the final evaluation
    assert 5 < len(both) <= len(learnt_from) == 80
    for each in both[3:]:
        assert same_batch(each, episodes[each.batch.explore, each.batch.first_episode])
