"""A run over topics records the same episodes, policies and updates as one in process."""

from collections.abc import Callable
from pathlib import Path

import pytest

from rkhs_ros.recordings.recording import read_recording
from test.ros.conftest import ROOT, Process
from test.unit.recordings.recorded_runs import content

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
