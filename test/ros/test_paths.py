"""Folders with any name: a run writes to and resumes exactly the requested folder."""

from collections.abc import Callable
from pathlib import Path

import pytest

from rkhs_ros.runs.curve import Curve
from test.ros.conftest import ROOT, Process

NAMES = ("a #b", " a: {x}\né ")  # what else a name may be, the readers' test has
SHORT = ("--set", "horizon=3", "episodes_per_iteration=2", "evaluation_episodes=1", "name='[x]: y'")


def lines(folder: Path) -> int:
    return len(Curve(folder / "curve.csv").rows())


@pytest.mark.nightly
@pytest.mark.parametrize("name", NAMES)
def test_a_run_over_topics_writes_to_the_requested_folder(
    start: Callable[..., Process], tmp_path: Path, name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    decoy = tmp_path / "a"  # what is left of the first name where it is read as YAML
    decoy.mkdir()
    config = ROOT / "config" / "toy_nac.yaml"
    first = start("rkhs", "train", config, "--runner", "ros", "--iterations", 1, "--out", name, *SHORT)
    assert first.finish()[0] == 0
    assert lines(tmp_path / name) == 1
    again = start("rkhs", "train", "--runner", "ros", "--resume", name, "--iterations", 2, "--quiet")
    assert again.finish()[0] == 0
    assert lines(tmp_path / name) == 2
    assert {path.name for path in tmp_path.iterdir()} == {"a", name}
    assert list(decoy.iterdir()) == []
