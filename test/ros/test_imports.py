"""Imports of the processes of a run: policy and learner nodes need no tasks or figures; only the learner records."""

from collections.abc import Callable
from pathlib import Path

import pytest

from test.ros.conftest import MODULES, Process

FOREIGN = {"gymnasium", "matplotlib", "mcap", "pybullet", "rosbags", "sim_nodes"}


@pytest.fixture
def imported(start: Callable[..., Process], parameters: Callable[..., Path], tmp_path: Path) -> dict[str, set[str]]:
    """The packages that each node of a short run has imported when it ends."""
    file = parameters("toy_nac", "iterations=2")
    learner = ("-p", f"output:={tmp_path / 'out'}", "-p", "quiet:=true")
    nodes = {
        name: start("imports", tmp_path / name, MODULES[name], "--ros-args", "--params-file", file, *more)
        for name, more in {"simulator": (), "policy": (), "learner": learner}.items()
    }
    assert nodes["learner"].finish() == (0, "", "")
    for name in ("simulator", "policy"):
        nodes[name].interrupt()
        assert nodes[name].finish() == (0, "", "")
    return {name: {line.partition(".")[0] for line in (tmp_path / name).read_text().splitlines()} for name in nodes}


def test_each_node_imports_only_what_it_needs(imported: dict[str, set[str]]) -> None:
    assert {name: packages & FOREIGN for name, packages in imported.items()} == {
        "simulator": {"gymnasium", "sim_nodes"},
        "policy": set(),
        "learner": {"mcap", "rosbags"},  # of the recording
    }
    assert all({"rclpy", "rkhs_interfaces", "rkhs_ros", "numpy"} <= packages for packages in imported.values())
