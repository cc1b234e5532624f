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
from rkhs_ros.nodes.core.names import namespaces, require_known_arguments
from rkhs_ros.runs.config import load_config

ABOUT = {
    "config": "parameter file, see config/",
    "output": "folder for the results; empty for results/NAME/TIME",
    "resume": "true: resume the run in the output folder, if there is one",
    "simulators": "number of simulator nodes that share the episodes; empty for that of the configuration",
    "namespace": "namespace of all nodes",
}
AGAIN = {"respawn": True, "respawn_delay": 1.0}
OnExit = Callable[[ProcessExited, LaunchContext], list[Action]]


def generate_launch_description() -> LaunchDescription:
    """Start simulator, policy and learner nodes; all exit with the learner, with its exit code.

    Killed simulator and policy nodes are restarted, and the learner continues with them.
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
    settings = [f"simulators={given['simulators']}"] if given["simulators"] else []
    simulators = load_config(Path(given["config"]), settings).training.simulators
    common = {"package": "rkhs_ros", "output": "screen"}
    learner = {"output": given["output"], "resume": given["resume"] == "true", "simulators": simulators}
    return [
        *(
            Node(
                executable="simulator",
                namespace="/".join(filter(None, (given["namespace"], namespace.rstrip("/")))),
                parameters=[given["config"]],
                on_exit=server_ended("simulator"),
                **common,
                **AGAIN,
            )
            for namespace in namespaces(simulators)
        ),
        Node(
            executable="policy",
            namespace=given["namespace"],
            parameters=[given["config"], {"simulators": simulators}],
            on_exit=server_ended("policy"),
            **common,
            **AGAIN,
        ),
        Node(
            executable="learner",
            namespace=given["namespace"],
            parameters=[given["config"], learner],
            on_exit=learner_ended,
            **common,
        ),
    ]


def learner_ended(event: ProcessExited, context: LaunchContext) -> list[Action]:
    """End the other nodes with the learner; raising makes ``ros2 launch`` exit with 1."""
    if event.returncode != 0 and not context.is_shutdown:
        raise RuntimeError(f"the learner exited with code {event.returncode}")
    return [Shutdown(reason="the learner is done")]


def server_ended(name: str) -> OnExit:
    """Return a handler that ends the run if a node exits before the learner without being killed."""

    def ended(event: ProcessExited, context: LaunchContext) -> list[Action]:
        if event.returncode >= 0 and not context.is_shutdown:
            raise RuntimeError(f"the {name} node exited before the learner, with code {event.returncode}")
        return []

    return ended
