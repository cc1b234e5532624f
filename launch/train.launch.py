"""Launch the nodes of a run: ``ros2 launch rkhs_ros train.launch.py config:=FILE``.

On a robot, start the robot's own nodes and arm the gate yourself. With ``simulated:=true``, the configuration's
simulated robot starts as well, and the gate arms itself if its settings say so. After a fault, resume the run with
``resume:=true``, and arm the gate again.
"""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from launch import LaunchContext, LaunchDescription
from launch.action import Action
from launch.actions import DeclareLaunchArgument, OpaqueFunction, Shutdown
from launch.events.process import ProcessExited
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import Node
from launch_ros.substitutions import FindPackageShare

from rkhs_ros.app.launcher import write_parameters
from rkhs_ros.app.robots import check_robot
from rkhs_ros.base.files import is_locked
from rkhs_ros.base.processes import search_here
from rkhs_ros.base.validation import require
from rkhs_ros.nodes.core.transport import node_names
from rkhs_ros.runs.config import Config, load_config
from rkhs_ros.runs.report import new_folder

CONFIG = PathJoinSubstitution([FindPackageShare("rkhs_ros"), "config", "pendulum_nac.yaml"])
ARGUMENTS = {  # defaults and descriptions
    "config": (CONFIG, "parameter file, see config/"),
    "output": ("", "folder for the results and the recording; results/NAME/TIME if empty"),
    "resume": ("false", "true: resume the run in the output folder, if there is one"),
    "simulated": ("false", "true: also start the simulated robot of the section /**/simulated_robot"),
    "namespace": ("", "namespace of all nodes"),
    "log_level": ("info", "log level of all nodes: debug, info, warn, error or fatal"),
}


def generate_launch_description() -> LaunchDescription:
    """Start the nodes of a run; all exit with the first one that exits."""
    arguments = [
        DeclareLaunchArgument(name, default_value=default, description=about)
        for name, (default, about) in ARGUMENTS.items()
    ]
    return LaunchDescription([*arguments, OpaqueFunction(function=nodes)])


def nodes(context: LaunchContext) -> list[Action]:
    """Write the parameter file and return the nodes; raise ValueError if the configuration is invalid."""
    given = {name: LaunchConfiguration(name).perform(context) for name in ARGUMENTS}
    for name in ("resume", "simulated"):
        require(given[name] in ("true", "false"), name, "true or false", given[name])
    config = _chosen(load_config(Path(given["config"])), simulated=given["simulated"] == "true")
    folder = (
        Path(given["output"]).expanduser() if given["output"] else new_folder(None, config.training.name)
    ).resolve()
    require(not is_locked(folder), "output", "a folder that no run uses", folder)
    resume = given["resume"] == "true"
    parameters = write_parameters(config, folder / "parameters.yaml", output=str(folder), resume=resume)
    return [
        Node(
            package="rkhs_ros",
            executable=name,
            namespace=given["namespace"],
            output="screen",
            parameters=[str(parameters)],
            ros_arguments=["--log-level", given["log_level"]],
            on_exit=_exited(name),
        )
        for name in node_names(config.environment.nodes)
    ]


def _chosen(config: Config, *, simulated: bool) -> Config:
    """Check a configuration with a robot, and omit its simulated robot unless it is to start."""
    robot = config.environment.nodes
    expected = "a section /**/simulated_robot in the configuration"
    require(not simulated or "simulated_robot" in robot, "simulated", expected, "none")
    if not robot:
        return config
    search_here()
    check_robot(config)
    chosen = {name: each for name, each in robot.items() if simulated or name != "simulated_robot"}
    return replace(config, environment=replace(config.environment, nodes=chosen))


def _exited(name: str) -> Callable[[ProcessExited, LaunchContext], list[Action]]:
    """Return a handler that ends the other nodes with the learner; raising makes ``ros2 launch`` exit with 1."""

    def exited(event: ProcessExited, context: LaunchContext) -> list[Action]:
        is_done = name == "learner" and event.returncode == 0
        if not (is_done or context.is_shutdown):
            raise RuntimeError(f"the {name} node exited with code {event.returncode} before the end of the run")
        return [Shutdown(reason="the learner is done")] if name == "learner" else []

    return exited
