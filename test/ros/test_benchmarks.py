"""Every script of benchmarks/ runs in seconds with --quick, and `make bench` runs all of them."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
SCRIPTS = sorted(path for path in (ROOT / "benchmarks").glob("*.py") if "__main__" in path.read_text())
pytestmark = [pytest.mark.slow, pytest.mark.nightly]


@pytest.mark.parametrize("script", SCRIPTS, ids=lambda path: path.stem)
@pytest.mark.usefixtures("domain")
def test_a_benchmark_runs_quickly(script: Path, tmp_path: Path) -> None:
    command = [sys.executable, str(script), "--quick"]
    environment = {k: v for k, v in os.environ.items() if k != "_ROS_WHEELS_BOOTSTRAP_COMPLETE"}
    done = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert done.stdout.replace("nothing to train\n", "")
    assert "Traceback" not in done.stderr
