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
    """Return the nodes of a run, with `robot` in place of the simulator; all exit with the first one that exits."""
    require(given["use_sim_time"] in ("true", "false"), "use_sim_time", "true or false", given["use_sim_time"])
    return [
        Node(
            package="rkhs_ros",
            executable=name,
            namespace=given["namespace"],
            output="screen",
            parameters=[str(parameters), {"use_sim_time": given["use_sim_time"] == "true"}],
            ros_arguments=["--log-level", given["log_level"]],
            on_exit=_exited(name),
        )
        for name in node_names(robot)
    ]


def _exited(name: str) -> OnExit:
    """Return a handler that ends the other nodes with the learner; raising makes ``ros2 launch`` exit with 1."""

    def exited(event: ProcessExited, context: LaunchContext) -> list[Action]:
        is_done = name == "learner" and event.returncode == 0
        if not (is_done or context.is_shutdown):
            raise RuntimeError(f"the {name} node exited with code {event.returncode} before the end of the run")
        return [Shutdown(reason="the learner is done")] if name == "learner" else []

    return exited
