"""The nodes of a run, for launch files."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from pathlib import Path

from launch.action import Action
from launch.actions import Shutdown
from launch.events.process import ProcessExited
from launch.launch_context import LaunchContext  # not from launch, which mypy takes for the folder of that name
from launch_ros.actions import Node

from rkhs_ros.base.validation import require
from rkhs_ros.nodes.core.transport import node_names

OnExit = Callable[[ProcessExited, LaunchContext], list[Action]]
OF_ALL_NODES = {  # arguments of every launch file
    "namespace": "namespace of all nodes",
    "log_level": "log level of all nodes: debug, info, warn, error or fatal",
    "use_sim_time": "true: take time stamps from /clock",
}
DEFAULTS = {"namespace": "", "log_level": "info", "use_sim_time": "false"}


def nodes_of_run(robot: Collection[str], parameters: Path, given: Mapping[str, str]) -> list[Action]:
    """Return the nodes of a run, with `robot` in place of the simulator; all exit with the first one that exits.

    Raises:
        ValueError: a value is invalid.
    """
    require(given["use_sim_time"] in ("true", "false"), "use_sim_time", "true or false", given["use_sim_time"])
    return [
        Node(
            package="rkhs_ros",
            executable=name,
            namespace=given["namespace"],
            output="screen",
            parameters=[str(parameters), {"use_sim_time": given["use_sim_time"] == "true"}],
            ros_arguments=["--log-level", given["log_level"]],
            on_exit=_learner_ended if name == "learner" else _server_ended(name),
        )
        for name in node_names(robot)
    ]


def _learner_ended(event: ProcessExited, context: LaunchContext) -> list[Action]:
    """End the other nodes with the learner; raising makes ``ros2 launch`` exit with 1."""
    if event.returncode != 0 and not context.is_shutdown:
        raise RuntimeError(f"the learner exited with code {event.returncode}")
    return [Shutdown(reason="the learner is done")]


def _server_ended(name: str) -> OnExit:
    """Return a handler that ends the run if a node exits before the learner."""

    def ended(event: ProcessExited, context: LaunchContext) -> list[Action]:
        if not context.is_shutdown:
            raise RuntimeError(f"the {name} node exited before the learner, with code {event.returncode}")
        return []

    return ended
