"""`make demo` learns over topics from one real episode, and tells it in three lines."""

import subprocess
import sys
from pathlib import Path

from demo import WITHOUT

from rkhs_ros.runs.curve import Curve
from test.ros.conftest import ROOT

OPTIMUM = 51.8


def test_the_demo_learns_from_one_episode_and_says_so(tmp_path: Path, domain: int) -> None:
    demo = subprocess.run(
        [sys.executable, ROOT / "docs" / "demo.py"], cwd=tmp_path, capture_output=True, text=True, timeout=60
    )
    assert demo.returncode == 0, demo.stderr
    explored, model_update, without = demo.stdout.splitlines()[-3:]
    (file,) = tmp_path.glob("results/demo/*/curve.csv")
    (row,) = Curve(file).rows()
    assert row.episodes == 1
    assert explored == f"One exploring episode (100 steps) earned {row.exploration_return:.1f}."
    assert f"the evaluation return is {row.evaluation_return:.1f} (optimum {OPTIMUM})" in model_update
    assert OPTIMUM + 1.0 > row.evaluation_return > 45.0 > 30.0 > row.exploration_return
    assert WITHOUT in without
