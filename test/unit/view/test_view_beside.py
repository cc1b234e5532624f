"""A page beside a run: it prints its address before the run starts, and ends without a message."""

import os
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

pytest.importorskip("viser")
pytestmark = pytest.mark.slow

CONFIG = Path(__file__).parents[3] / "config" / "toy_nac.yaml"
Start = Callable[..., "subprocess.Popen[str]"]


@pytest.fixture
def start(tmp_path: Path) -> Iterator[Start]:
    """Start training with a page; processes that remain are killed after the test."""
    started: list[subprocess.Popen[str]] = []

    def begin(*arguments: str) -> "subprocess.Popen[str]":
        command = [sys.executable, "-m", "rkhs_ros.app.cli", "train", str(CONFIG), "--runner", "inline", "--view"]
        environment = os.environ | {"OMP_NUM_THREADS": "1"}
        started.append(
            subprocess.Popen(
                [*command, "--out", str(tmp_path / "run"), *arguments],
                stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=environment,
            )
        )  # fmt: skip
        return started[-1]

    yield begin
    for each in started:
        each.kill()
        each.communicate()


def test_the_address_is_printed_before_a_short_run_and_the_page_ends_silently(start: Start, tmp_path: Path) -> None:
    run = start("--iterations", "1", "--quiet")
    assert run.stdout is not None
    assert run.stderr is not None
    address = f"View {tmp_path / 'run'} at http://localhost:"
    assert run.stdout.readline().startswith(address)
    assert run.stdout.readline().startswith("Trained on rkhs/Toy-v0")
    assert run.stderr.readline() == "The page stays open until Ctrl-C.\n"
    run.send_signal(signal.SIGINT)
    out, err = run.communicate()
    assert (run.returncode, err) == (0, "")
    assert address not in out
