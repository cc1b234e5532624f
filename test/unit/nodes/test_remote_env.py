"""The remote environment without ROS."""

import sys

import gymnasium
import pytest

import sim_nodes.envs  # noqa: F401  # registers it


@pytest.mark.parametrize("make", [gymnasium.make, gymnasium.make_vec])
def test_without_ros_the_error_names_what_to_install(monkeypatch: pytest.MonkeyPatch, make: object) -> None:
    for module in ("remote_env", "remote_simulation"):
        monkeypatch.delitem(sys.modules, f"rkhs_ros.nodes.remote.{module}", raising=False)
    monkeypatch.setitem(sys.modules, "rclpy", None)
    with pytest.raises(gymnasium.error.DependencyNotInstalled, match=r"rkhs/Remote-v0: expected ROS 2 Jazzy"):
        make("rkhs/Remote-v0")  # type: ignore[operator]
