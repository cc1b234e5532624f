"""A run trains even if its standard streams are closed or full."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from rkhs_ros.runs.curve import Curve

pytestmark = pytest.mark.slow

CONFIG = Path(__file__).parents[3] / "config" / "toy_nac.yaml"
COMMAND = (sys.executable, "-m", "rkhs_ros.app.cli")
RUN = ("train", str(CONFIG), "--runner", "inline", "--iterations", "3", "--out")


RARE = ("2>/dev/full", "2>&-", ">/dev/full", ">&-", "2>/dev/full >/dev/full")


@pytest.mark.parametrize(
    "streams", ["2>&- >&- <&-", *(pytest.param(streams, marks=pytest.mark.nightly) for streams in RARE)]
)
def test_a_run_succeeds_without_standard_streams(tmp_path: Path, streams: str) -> None:
    command = ["bash", "-c", f'"$@" {streams}', "bash", *COMMAND, *RUN, str(tmp_path / "run")]
    done = subprocess.run(command, stdin=subprocess.DEVNULL, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert "note:" not in done.stdout  # messages of a closed standard error do not go to standard output
    assert len(Curve(tmp_path / "run" / "curve.csv").rows()) == 3


def test_a_closed_pipe_does_not_stop_a_run(tmp_path: Path) -> None:
    reading, writing = os.pipe()
    process = subprocess.Popen([*COMMAND, *RUN, str(tmp_path / "run")], stdout=writing, stderr=writing)
    os.close(writing)
    os.close(reading)
    assert process.wait() == 0
    assert len(Curve(tmp_path / "run" / "curve.csv").rows()) == 3


def test_a_command_fails_if_its_output_is_lost(tmp_path: Path) -> None:
    command = ["bash", "-c", '"$@" >/dev/full', "bash", *COMMAND, "list"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (1, "error: [Errno 28] No space left on device: '<stdout>'\n")


def test_a_reader_that_stops_early_is_no_error() -> None:
    reading, writing = os.pipe()
    os.close(reading)
    done = subprocess.run([*COMMAND, "list"], stdout=writing, stderr=subprocess.PIPE, text=True, check=False)
    os.close(writing)
    assert (done.returncode, done.stderr) == (0, "")
