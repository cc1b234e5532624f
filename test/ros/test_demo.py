"""`make demo` learns over topics from one real episode, and prints the returns before and after."""

import re
import subprocess
import sys
from pathlib import Path

from demo import WITHOUT_A_MODEL

from rkhs_ros.runs.curve import Curve
from test.ros.conftest import ROOT

OPTIMUM = 51.8


def test_the_demo_learns_from_one_episode_and_prints_the_returns(tmp_path: Path, domain: int) -> None:
    demo = subprocess.run(
        [sys.executable, ROOT / "docs" / "demo.py"], cwd=tmp_path, capture_output=True, text=True, timeout=60
    )
    assert demo.returncode == 0, demo.stderr
    (file,) = tmp_path.glob("results/demo/*/curve.csv")
    (row,) = Curve(file).rows()
    assert row.episodes == 1
    assert OPTIMUM + 1.0 > row.evaluation_return > 45.0 > 30.0 > row.exploration_return
    returns = [float(number) for number in re.findall(r"^ *([\d.]+)  [ia]", demo.stdout, re.MULTILINE)]
    assert returns == [round(row.exploration_return, 1), round(row.evaluation_return, 1), OPTIMUM]
    assert f"rkhs render {file.parent.relative_to(tmp_path)}" in demo.stdout


def test_the_demo_compares_with_the_results_of_the_documentation() -> None:
    rows = (ROOT / "docs" / "configurations.md").read_text()
    (medians,) = re.findall(
        r"^\| `pendulum_wrap_few_nac` \| 100 to 119 \| (\d+) [^|]*\|[^|]*\| (\d+) ", rows, re.MULTILINE
    )
    assert [int(median) for median in medians] == list(WITHOUT_A_MODEL.values())
