"""Launch the nodes of a run: ``ros2 launch rkhs_ros train.launch.py config:=FILE``."""

from __future__ import annotations

from pathlib import Path

from launch import LaunchContext, LaunchDescription
from launch.action import Action
from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.substitutions import FindPackageShare

from rkhs_ros.app.launcher import write_parameters
from rkhs_ros.base.validation import require
from rkhs_ros.nodes.core.launching import DEFAULTS, OF_ALL_NODES, nodes_of_run
from rkhs_ros.runs.config import load_config
from rkhs_ros.runs.report import new_folder

ABOUT = {
    "config": "parameter file, see config/",
    "output": "folder for the results; empty for results/NAME/TIME",
    "resume": "true: resume the run in the output folder, if there is one",
    **OF_ALL_NODES,
}


def generate_launch_description() -> LaunchDescription:
    """Start simulator, policy and learner nodes; all exit with the first one that exits.

    After a fault, resume the run with ``resume:=true``.
    """
    share = FindPackageShare("rkhs_ros")
    file = PathJoinSubstitution([share, "config", "pendulum_nac.yaml"])
    defaults = {"config": file, "resume": "false", **DEFAULTS}
    arguments = [
        DeclareLaunchArgument(name, default_value=defaults.get(name, ""), description=about)
        for name, about in ABOUT.items()
    ]
    return LaunchDescription([*arguments, OpaqueFunction(function=nodes)])


def nodes(context: LaunchContext) -> list[Action]:
    """Return the nodes for the arguments of the launch file.

    Raises:
        ValueError: an argument is invalid, or the configuration is.
    """
    given = {name: LaunchConfiguration(name).perform(context) for name in ABOUT}
    require(given["resume"] in ("true", "false"), "resume", "true or false", given["resume"])
    config = load_config(Path(given["config"]))
    require(not config.environment.nodes, given["config"], "a section /**/simulator", "a robot")
    folder = Path(given["output"]).expanduser() if given["output"] else new_folder(None, config.training.name)
    output = str(folder.resolve())
    file = write_parameters(config, folder / "parameters.yaml", output=output, resume=given["resume"] == "true")
    return nodes_of_run((), file, given)
