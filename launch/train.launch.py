"""Launch the nodes of a run: ``ros2 launch rkhs_ros train.launch.py config:=FILE``."""

from __future__ import annotations

import sys
from pathlib import Path

from launch import LaunchContext, LaunchDescription
from launch.action import Action
from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.substitutions import FindPackageShare

from rkhs_ros.base.validation import require
from rkhs_ros.nodes.core.launching import nodes_of_run
from rkhs_ros.nodes.core.names import require_known_arguments

ABOUT = {
    "config": "parameter file, see config/",
    "output": "folder for the results; empty for results/NAME/TIME",
    "resume": "true: resume the run in the output folder, if there is one",
    "namespace": "namespace of all nodes",
}


def generate_launch_description() -> LaunchDescription:
    """Start simulator, policy and learner nodes; all exit with the first one that exits.

    After a fault, resume the run with ``resume:=true``.
    """
    share = FindPackageShare("rkhs_ros")
    defaults = {"config": PathJoinSubstitution([share, "config", "pendulum_nac.yaml"]), "resume": "false"}
    arguments = [
        DeclareLaunchArgument(name, default_value=defaults.get(name, ""), description=about)
        for name, about in ABOUT.items()
    ]
    return LaunchDescription([*arguments, OpaqueFunction(function=nodes)])


def nodes(context: LaunchContext) -> list[Action]:
    """Return the nodes for the arguments of the launch file.

    Raises:
        ValueError: an argument is unknown or invalid.
    """
    require_known_arguments(sys.argv, Path(__file__).name, ABOUT)
    given = {name: LaunchConfiguration(name).perform(context) for name in ABOUT}
    require(given["resume"] in ("true", "false"), "resume", "true or false", given["resume"])
    learner = {"output": given["output"], "resume": given["resume"] == "true"}
    parameters = {"policy": [given["config"]], "simulator": [given["config"]], "learner": [given["config"], learner]}
    return nodes_of_run(parameters, given["namespace"])
