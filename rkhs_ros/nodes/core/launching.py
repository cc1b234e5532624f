"""The nodes of a run, for launch files."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from pathlib import Path
from typing import Any

from launch.action import Action
from launch.actions import DeclareLaunchArgument, OpaqueFunction, Shutdown
from launch.events.process import ProcessExited
from launch.launch_context import LaunchContext  # not from launch, which mypy takes for the folder of that name
from launch.launch_description import LaunchDescription
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

from rkhs_ros.base.validation import require
from rkhs_ros.nodes.core.transport import node_names

Given = Mapping[str, str]  # the arguments of a launch file
ABOUT = {  # arguments of the launch files
    "config": "parameter file, see config/",
    "output": "folder for the results and the recording",
    "resume": "true: resume the run in the output folder, if there is one",
    "simulated": "true: also start the simulated robot of the section /**/simulated_robot",
    "namespace": "namespace of all nodes",
    "log_level": "log level of all nodes: debug, info, warn, error or fatal",
}
DEFAULTS = {"resume": "false", "namespace": "", "log_level": "info"}
SWITCHES = ("resume", "simulated")


def description(prepare: Callable[[Given], tuple[Collection[str], Path]], **defaults: Any) -> LaunchDescription:
    """Return a description that starts the nodes of a run; all exit with the first one that exits."""
    defaults |= DEFAULTS

    def nodes(context: LaunchContext) -> list[Action]:
        given = {name: LaunchConfiguration(name).perform(context) for name in defaults}
        for name in given.keys() & SWITCHES:
            require(given[name] in ("true", "false"), name, "true or false", given[name])
        robot, parameters = prepare(given)
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
            for name in node_names(robot)
        ]

    arguments = [
        DeclareLaunchArgument(name, description=ABOUT[name], **({} if value is None else {"default_value": value}))
        for name, value in defaults.items()
    ]
    return LaunchDescription([*arguments, OpaqueFunction(function=nodes)])


def _exited(name: str) -> Callable[[ProcessExited, LaunchContext], list[Action]]:
    """Return a handler that ends the other nodes with the learner; raising makes ``ros2 launch`` exit with 1."""

    def exited(event: ProcessExited, context: LaunchContext) -> list[Action]:
        is_done = name == "learner" and event.returncode == 0
        if not (is_done or context.is_shutdown):
            raise RuntimeError(f"the {name} node exited with code {event.returncode} before the end of the run")
        return [Shutdown(reason="the learner is done")] if name == "learner" else []

    return exited
