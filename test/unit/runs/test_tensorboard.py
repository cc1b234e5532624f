"""TensorBoard events: the rows of curve.csv exactly once."""

import os
import struct
import subprocess
import sys
from collections.abc import Callable
from itertools import pairwise
from math import isfinite
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from rkhs_ros.base import ros
from rkhs_ros.runs import tensorboard
from rkhs_ros.runs.config import Config, Environment
from rkhs_ros.runs.curve import BEGINNING, Curve
from rkhs_ros.runs.run import run_training
from rkhs_ros.runs.tensorboard import has_events, logged
from test.unit.conftest import Result, assert_refused, model_free
from test.unit.runs.stopping import Stopping

TRAINING = model_free(name="short", iterations=4, episodes_per_iteration=2, evaluation_episodes=1, horizon=4)
CONFIG = Config(Environment("rkhs/Toy-v0", {}), TRAINING)
CONFIG_FILE = Path(__file__).parents[3] / "config" / "toy_nac.yaml"
Cli = Callable[..., Result]
Rows = dict[int, dict[str, float]]  # values by iteration and column


def stopped(folder: Path, batches: int, *, tensorboard: bool = False) -> Path:
    with pytest.raises(KeyboardInterrupt):
        run_training(CONFIG, Stopping(batches), folder, quiet=True, tensorboard=tensorboard)
    return folder


def resumed(folder: Path, *, tensorboard: bool = False) -> Path:
    return run_training(CONFIG, Stopping(), folder, quiet=True, resume=True, tensorboard=tensorboard)


def expected(folder: Path) -> Rows:
    """Return the finite values of curve.csv."""
    rows = [row._asdict() for row in Curve(folder / "curve.csv").rows()]
    return {row.pop("iteration"): {name: value for name, value in row.items() if isfinite(value)} for row in rows}


def in_single_precision(rows: Rows) -> Rows:
    return {step: {name: float(np.float32(value)) for name, value in row.items()} for step, row in rows.items()}


def events(folder: Path) -> list[tuple[int, float, dict[str, float]]]:
    """Return step, time and values of the events with values, from all event files of a run."""
    proto = pytest.importorskip("tensorboardX.proto.event_pb2")
    found = []
    for file in sorted((folder / "tensorboard").iterdir()):
        content = file.read_bytes()
        while content:
            end = 12 + struct.unpack_from("<Q", content)[0]  # after the length and its checksum
            event, content = proto.Event.FromString(content[12:end]), content[end + 4 :]
            if event.summary.value:
                found.append((event.step, event.wall_time, {v.tag: v.simple_value for v in event.summary.value}))
    return found


def test_event_files_contain_each_row_once_after_any_interruption(tmp_path: Path) -> None:
    pytest.importorskip("tensorboardX")
    folder = stopped(tmp_path / "run", 5, tensorboard=True)  # in the third iteration
    assert [step for step, *_ in events(folder)] == [1, 2]
    (file,) = (folder / "tensorboard").iterdir()
    file.write_bytes(file.read_bytes()[:-20])  # as after a power cut
    logged_rows = events(resumed(folder))
    assert [step for step, *_ in logged_rows] == [1, 2, 3, 4]
    assert {step: values for step, _, values in logged_rows} == in_single_precision(expected(folder))
    assert all(earlier < later for (_, earlier, _), (_, later, _) in pairwise(logged_rows))


def test_a_log_that_begins_with_a_resume_contains_all_rows_and_changes_no_result(tmp_path: Path) -> None:
    pytest.importorskip("tensorboardX")
    without = run_training(CONFIG, Stopping(), tmp_path / "without", quiet=True)
    folder = resumed(stopped(tmp_path / "run", 5), tensorboard=True)
    assert [step for step, *_ in events(folder)] == [1, 2, 3, 4]
    names = ("policy.npz", "config.yaml")
    assert [(folder / name).read_bytes() for name in names] == [(without / name).read_bytes() for name in names]


def test_tensorboard_reads_the_rows_also_while_a_run_resumes(tmp_path: Path) -> None:
    reader = pytest.importorskip("tensorboard.backend.event_processing.event_accumulator")
    pytest.importorskip("tensorboardX")
    folder = stopped(tmp_path / "run", 5, tensorboard=True)
    during = reader.EventAccumulator(str(folder / "tensorboard")).Reload()
    assert [scalar.step for scalar in during.Scalars("evaluation_return")] == [1, 2]
    resumed(folder)
    for read in (during.Reload(), reader.EventAccumulator(str(folder / "tensorboard")).Reload()):
        rows: Rows = {}
        for name in read.Tags()["scalars"]:
            scalars = read.Scalars(name)
            assert len({scalar.step for scalar in scalars}) == len(scalars)
            for scalar in scalars:
                rows.setdefault(scalar.step, {})[name] = scalar.value
        assert rows == in_single_precision(expected(folder))


@pytest.mark.nightly
@pytest.mark.ros
@pytest.mark.slow
@pytest.mark.skipif(bool(ros.missing_ros()), reason="needs ROS")
def test_the_learner_node_logs_like_a_run_in_one_process(tmp_path: Path) -> None:
    pytest.importorskip("tensorboardX")
    command = [sys.executable, "-m", "rkhs_ros.app.cli", "train", "--quiet"]
    source = [CONFIG_FILE, "--iterations", "2", "--runner", "ros", "--tensorboard", "--out", "run"]
    subprocess.run([*command, *source], cwd=tmp_path, check=True, capture_output=True, timeout=100)
    subprocess.run([*command, "--resume", "run", "--iterations", "3"], cwd=tmp_path, check=True, capture_output=True)
    logged_rows = events(tmp_path / "run")
    assert [step for step, *_ in logged_rows] == [1, 2, 3]
    assert {step: values for step, _, values in logged_rows} == in_single_precision(expected(tmp_path / "run"))


def test_a_missing_package_is_reported_before_the_run(
    rkhs: Cli, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "tensorboardX", None)
    expected = (
        "--tensorboard: expected tensorboardX to be installed (pip install tensorboardX, or the extra 'tensorboard')"
    )
    assert_refused(rkhs("train", CONFIG_FILE, "--tensorboard", "--out", "run"), expected)
    assert not (tmp_path / "run").exists()
    (tmp_path / "old" / "tensorboard").mkdir(parents=True)
    with pytest.raises(ValueError, match="--tensorboard: expected tensorboardX to be installed"):
        has_events(tmp_path / "old", requested=False)


class Full:
    """An event file on a disk that is full from a row on."""

    def __init__(self, row: int) -> None:
        self.added: list[int] = []
        self.row = row

    def add(self, row: Any) -> None:
        if row.iteration >= self.row:
            raise OSError(28, os.strerror(28), "events")
        self.added.append(row.iteration)

    def close(self) -> None:
        self.added.append(-1)


@pytest.mark.parametrize("full_from", [0, 2, 9])
def test_a_run_continues_without_events_that_fail(
    full_from: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    full = Full(full_from)

    def opened(*arguments: object) -> Full:
        if full_from == 0:
            raise OSError(28, os.strerror(28), "events")
        return full

    monkeypatch.setattr(tensorboard, "EventFile", opened)

    def interrupted_run() -> None:
        with logged(tmp_path, []) as add:
            for iteration in (1, 2, 3):
                add(BEGINNING._replace(iteration=iteration))
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        interrupted_run()
    assert full.added == {0: [], 2: [1], 9: [1, 2, 3, -1]}[full_from]
    warning = "warning: --tensorboard: [Errno 28] No space left on device: 'events'. The run continues without it\n"
    assert capsys.readouterr().err == warning * (full_from < 9)
