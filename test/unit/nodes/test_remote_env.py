"""The remote environment without ROS."""

import sys

import gymnasium
import pytest

import sim_nodes.envs  # noqa: F401  # registers it


def test_without_ros_the_error_names_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("lockstep.remote_env", "core.peers"):  # which another test may have imported with ROS
        monkeypatch.delitem(sys.modules, f"rkhs_ros.nodes.{name}", raising=False)
    monkeypatch.setitem(sys.modules, "rclpy", None)
    with pytest.raises(gymnasium.error.DependencyNotInstalled, match=r"rkhs/Remote-v0: expected ROS 2 Jazzy"):
        gymnasium.make("rkhs/Remote-v0")
