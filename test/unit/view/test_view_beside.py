"""A page beside a run: it prints its address before the run starts, and ends without a message."""

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

pytest.importorskip("viser")
pytestmark = pytest.mark.slow

CONFIG = Path(__file__).parents[3] / "config" / "toy_nac.yaml"


def test_the_address_is_printed_before_a_short_run_and_the_page_ends_silently(tmp_path: Path) -> None:
    words = ["train", CONFIG, "--runner", "inline", "--view", "--out", tmp_path / "run", "--iterations", 1, "--quiet"]
    command = [sys.executable, "-m", "rkhs_ros.app.cli", *map(str, words)]
    pipes: dict[str, int] = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
    run = subprocess.Popen(command, text=True, env=os.environ | {"OMP_NUM_THREADS": "1"}, **pipes)
    address = f"View {tmp_path / 'run'} at http://localhost:"
    try:
        assert run.stdout.readline().startswith(address)
        assert run.stdout.readline().startswith("Trained on rkhs/Toy-v0")
        assert run.stderr.readline() == "The page stays open until Ctrl-C.\n"
        run.send_signal(signal.SIGINT)
        out, err = run.communicate()
    finally:
        run.kill()
    assert (run.returncode, err) == (0, "")
    assert address not in out
