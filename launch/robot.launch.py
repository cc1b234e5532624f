"""Launch the nodes that learn on a robot: ``ros2 launch rkhs_ros robot.launch.py config:=FILE output:=DIR``.

Start the robot's own nodes and arm the gate yourself. With ``simulated:=true``, the configuration's simulated robot
starts as well, and the robot node arms the gate.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from launch import LaunchContext, LaunchDescription
from launch.action import Action
from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch.substitutions import LaunchConfiguration

from rkhs_ros.app.launcher import write_parameters
from rkhs_ros.app.robots import check_robot
from rkhs_ros.base.processes import search_here
from rkhs_ros.base.validation import require
from rkhs_ros.nodes.core.launching import DEFAULTS, OF_ALL_NODES, nodes_of_run
from rkhs_ros.runs.config import load_config

ABOUT = {
    "config": "parameter file with the sections /**/robot, /**/gate and /**/learner",
    "output": "folder for the results and the robot's episodes",
    "resume": "true: resume the run in the output folder, if there is one",
    "simulated": "true: also start the simulated robot of the section /**/simulated_robot",
    **OF_ALL_NODES,
}


def generate_launch_description() -> LaunchDescription:
    """Start gate, robot, policy and learner nodes; all exit with the first one that exits.

    After a fault, resume the run with ``resume:=true``, and arm the gate again.
    """
    defaults = {"resume": "false", "simulated": "false", **DEFAULTS}
    arguments = [
        DeclareLaunchArgument(
            name, description=about, **({"default_value": defaults[name]} if name in defaults else {})
        )
        for name, about in ABOUT.items()
    ]
    return LaunchDescription([*arguments, OpaqueFunction(function=nodes)])


def nodes(context: LaunchContext) -> list[Action]:
    """Return the nodes for the arguments of the launch file.

    Raises:
        ValueError: an argument is invalid, or a section of the configuration is.
    """
    given = {name: LaunchConfiguration(name).perform(context) for name in ABOUT}
    for name in ("resume", "simulated"):
        require(given[name] in ("true", "false"), name, "true or false", given[name])
    search_here()
    config, folder = load_config(Path(given["config"])), Path(given["output"]).expanduser().resolve()
    require(bool(config.environment.nodes), given["config"], "a section /**/robot", "none")
    simulated = given["simulated"] == "true"
    expected = "a section /**/simulated_robot in the configuration"
    require(not simulated or "simulated_robot" in config.environment.nodes, "simulated", expected, "none")
    check_robot(config)
    if not simulated:
        robot = {name: each for name, each in config.environment.nodes.items() if name != "simulated_robot"}
        config = replace(config, environment=replace(config.environment, nodes=robot))
    file = write_parameters(config, folder / "parameters.yaml", output=str(folder), resume=given["resume"] == "true")
    return nodes_of_run(config.environment.nodes, file, given)
