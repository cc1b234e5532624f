"""Launch the nodes of a run: ``ros2 launch rkhs_ros train.launch.py config:=FILE``."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path

from launch import LaunchContext, LaunchDescription
from launch.action import Action
from launch.actions import DeclareLaunchArgument, OpaqueFunction, Shutdown
from launch.events.process import ProcessExited
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import Node
from launch_ros.substitutions import FindPackageShare

from rkhs_ros.base.validation import require
from rkhs_ros.nodes.core.names import require_known_arguments

ABOUT = {
    "config": "parameter file, see config/",
    "output": "folder for the results; empty for results/NAME/TIME",
    "resume": "true: resume the run in the output folder, if there is one",
    "namespace": "namespace of all nodes",
}
OnExit = Callable[[ProcessExited, LaunchContext], list[Action]]


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
    return [
        Node(
            package="rkhs_ros",
            executable=name,
            namespace=given["namespace"],
            output="screen",
            parameters=own,
            on_exit=learner_ended if name == "learner" else server_ended(name),
        )
        for name, own in parameters.items()
    ]


def learner_ended(event: ProcessExited, context: LaunchContext) -> list[Action]:
    """End the other nodes with the learner; raising makes ``ros2 launch`` exit with 1."""
    if event.returncode != 0 and not context.is_shutdown:
        raise RuntimeError(f"the learner exited with code {event.returncode}")
    return [Shutdown(reason="the learner is done")]


def server_ended(name: str) -> OnExit:
    """Return a handler that ends the run if a node exits before the learner."""

    def ended(event: ProcessExited, context: LaunchContext) -> list[Action]:
        if not context.is_shutdown:
            raise RuntimeError(f"the {name} node exited before the learner, with code {event.returncode}")
        return []

    return ended
