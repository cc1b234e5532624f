"""Failures of runs on a robot: a gate that dies, a veto, a reset that never succeeds."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
from std_srvs.srv import Trigger

from rkhs_ros.recordings.recording import RecordedBatch, read_recording
from rkhs_ros.runs.curve import Curve
from rkhs_ros.runs.replay import replay
from test.ros.conftest import Probe, Process, kill, nodes_of, probe
from test.ros.robot_bench import CONFIG, QUICK

__all__ = ["probe"]
Start = Callable[..., Process]


def test_a_gate_that_dies_ends_the_run(start: Start, tmp_path: Path, probe: Probe) -> None:
    folder = tmp_path / "run"
    run = start("rkhs", "train", CONFIG, "--quiet", "--out", folder, "--set", *QUICK, "iterations=100")
    probe.until(lambda: bool(probe.heard["episodes"]) or run.popen.poll() is not None, 100)
    for pid in nodes_of(run, "gate"):
        kill(pid)
    code, _, err = run.finish()
    assert code == 1
    assert "error: the gate node was killed by signal 9; without it the robot must not move" in err


def test_a_veto_holds_if_the_run_is_interrupted_and_resumed(start: Start, tmp_path: Path, probe: Probe) -> None:
    folder = tmp_path / "run"
    more = ("iterations=1", "episodes_per_iteration=3", "horizon=300", "robot.misses_allowed=150")
    run = start("rkhs", "train", CONFIG, "--quiet", "--out", folder, "--set", *QUICK, *more)
    probe.add_service("robot/veto", Trigger)
    probe.until(lambda: any(m.first_episode == 1 and m.step > 1 for m in probe.heard["observation"]), 100)
    assert probe.ask_once("robot/veto", Trigger.Request(), "robot").success

    def vetoed() -> list[RecordedBatch]:
        batches = read_recording(folder).batches
        return [each for each in batches if each.executions[0].discard_reason == "vetoed by the operator"]

    probe.until(vetoed, 100)
    run.interrupt()
    run.finish()
    (discarded,) = vetoed()
    recording = read_recording(folder)
    places = [k for k, each in enumerate(recording.batches) if each.attempt == discarded.attempt]
    assert [recording.batches[place].is_discarded for place in places] == [False, True]
    assert places[1] == places[0] + 1  # recorded at once, not at the end of the next episode
    assert discarded.batch not in recording.by_numbers()
    code, _, err = start("rkhs", "train", "--quiet", "--resume", folder).finish()
    assert code == 0, err
    recording = read_recording(folder)
    assert recording.by_numbers()[discarded.batch].attempt != discarded.attempt
    assert len(recording.finished) == 3
    assert len(list(replay(recording))) == 1
    (row,) = Curve(folder / "curve.csv").rows()
    np.testing.assert_allclose(row.exploration_return, np.mean(recording.episodes().returns(0.99)))
