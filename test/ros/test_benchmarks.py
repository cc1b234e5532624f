"""Every script of benchmarks/ runs in seconds with --quick, and `make bench` runs all of them."""

import os
import shutil
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
    done = subprocess.run(
        command,
        cwd=tmp_path,
        env={k: v for k, v in os.environ.items() if k != "_ROS_WHEELS_BOOTSTRAP_COMPLETE"},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    if done.stderr.startswith("skipped: "):
        assert done.stderr.startswith(f"skipped: {script.name}: expected ")
        pytest.skip(done.stderr.strip())
    assert done.stdout
    assert "Traceback" not in done.stderr


def test_all_benchmarks_run_even_if_some_fail(tmp_path: Path) -> None:
    scripts = tmp_path / "benchmarks"
    scripts.mkdir()
    for name, code in (("a", 1), ("b", 0), ("c", 3)):
        (scripts / f"{name}.py").write_text(f'if __name__ == "__main__":\n    print("{name} ran")\n    exit({code})\n')
    shutil.copy(ROOT / "Makefile", tmp_path)
    as_built = ("-o", "install/.built", "ENTER=")
    done = subprocess.run(["make", *as_built, "bench"], cwd=tmp_path, capture_output=True, text=True, check=False)
    assert [line for line in done.stdout.splitlines() if line.endswith("ran")] == ["a ran", "b ran", "c ran"]
    assert done.returncode == 2  # make's own
    assert "failed: benchmarks/a.py benchmarks/c.py\n" in done.stderr
