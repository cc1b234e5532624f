"""Over topics and in process: the same curve and the same policy, to the last bit."""

import csv
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from test.ros.conftest import ROOT, Process

Start = Callable[..., Process]
SHORT = ("--quiet", "--iterations", 3, "--seed", 7)


def curve(folder: Path) -> list[dict[str, str]]:
    rows = list(csv.DictReader((folder / "curve.csv").open()))
    return [{name: value for name, value in row.items() if name != "seconds"} for row in rows]


@pytest.mark.parametrize(
    ("config", "changes"),
    [
        ("pendulum_nac", ()),
        ("pendulum_nac", ("algorithm.critic=trajectory", "episodes_per_iteration=3", "evaluation_episodes=1")),
        ("pendulum_power", ("horizon=40",)),
        ("toy_power", ("kernel.form=rbf + polynomial", "discount=0.9")),
        ("pendulum_v1", ("horizon=30",)),
    ],
)
def test_a_run_over_topics_equals_the_run_in_process(
    start: Start, tmp_path: Path, config: str, changes: tuple[str, ...]
) -> None:
    settings = [word for change in changes for word in ("--set", change)]
    for runner in ("ros", "inline"):
        arguments = (ROOT / "config" / f"{config}.yaml", *SHORT, *settings, "--runner", runner)
        code, out, err = start("rkhs", "train", *arguments, "--out", tmp_path / runner).finish()
        assert (code, err) == (0, "")
        assert out.count("\n") == 3
    assert curve(tmp_path / "ros") == curve(tmp_path / "inline")
    assert len(curve(tmp_path / "ros")) == 3
    with np.load(tmp_path / "ros" / "policy.npz") as a, np.load(tmp_path / "inline" / "policy.npz") as b:
        assert a.files == b.files
        assert all(np.array_equal(a[name], b[name]) for name in a.files)
    assert (tmp_path / "ros" / "config.yaml").read_text() == (tmp_path / "inline" / "config.yaml").read_text()


def test_runs_side_by_side_in_different_domains_do_not_meet(
    start: Start, tmp_path: Path, domain: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    config = ROOT / "config" / "toy_nac.yaml"
    alone = start("rkhs", "train", config, *SHORT, "--out", tmp_path / "alone").finish()
    first = start("rkhs", "train", config, *SHORT, "--out", tmp_path / "first")
    monkeypatch.setenv("ROS_DOMAIN_ID", str(domain + 101))  # outside the range that tests take theirs from
    second = start("rkhs", "train", config, *SHORT[:-1], 8, "--out", tmp_path / "second")
    assert [alone[0], first.finish()[0], second.finish()[0]] == [0, 0, 0]
    assert curve(tmp_path / "first") == curve(tmp_path / "alone")
    assert curve(tmp_path / "second") != curve(tmp_path / "alone")
