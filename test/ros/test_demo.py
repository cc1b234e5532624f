"""`make demo` learns over topics from a few real episodes, and prints the returns before and after."""

import re
import subprocess
import sys
from pathlib import Path

import pytest
from demo import EPISODES, WITHOUT_A_MODEL

from rkhs_ros.runs.curve import Curve
from test.ros.conftest import ROOT

OPTIMUM = 51.8


@pytest.mark.ci
def test_the_demo_learns_from_few_episodes_and_prints_the_returns(tmp_path: Path, domain: int) -> None:
    demo = subprocess.run(
        [sys.executable, ROOT / "docs" / "demo.py"], cwd=tmp_path, capture_output=True, text=True, timeout=250
    )
    assert demo.returncode == 0, demo.stderr
    (file,) = tmp_path.glob("results/demo/*/curve.csv")
    row, *_, last = Curve(file).rows()
    assert (row.episodes, last.episodes) == (1, EPISODES)
    assert OPTIMUM + 1.0 > row.evaluation_return > 45.0 > 30.0 > row.exploration_return
    returns = [float(number) for number in re.findall(r"^ *([\d.]+)  [ia]", demo.stdout, re.MULTILINE)]
    shown = (row.exploration_return, row.evaluation_return, last.evaluation_return)
    assert returns == [*(round(each, 1) for each in shown), OPTIMUM]
    assert all((tmp_path / name).is_file() for name in re.findall(r"\S+\.png", demo.stdout))
    assert f"rkhs render {file.parent.relative_to(tmp_path)}" in demo.stdout


def test_the_demo_compares_with_the_results_of_the_documentation() -> None:
    rows = (ROOT / "docs" / "configurations.md").read_text()
    (medians,) = re.findall(
        r"^\| `pendulum_wrap_few_nac` \| 100 to 119 \| (\d+) [^|]*\|[^|]*\| (\d+) ", rows, re.MULTILINE
    )
    assert [int(median) for median in medians] == list(WITHOUT_A_MODEL.values())
