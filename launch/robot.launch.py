"""The nodes that learn on a robot: ``ros2 launch rkhs_ros robot.launch.py config:=FILE output:=DIR``.

The robot's own nodes are not started here, nor is its gate armed: that is for a person to do. With ``simulated:=true``
the configuration's simulated robot is started, too, and its gate is armed by the robot node.
"""

from __future__ import annotations

import sys
from pathlib import Path

from launch import LaunchContext, LaunchDescription
from launch.action import Action
from launch.actions import DeclareLaunchArgument, OpaqueFunction, Shutdown
from launch.events.process import ProcessExited
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

from rkhs_ros.app.launcher import robot_parameters
from rkhs_ros.app.robots import check_robot
from rkhs_ros.base.validation import require
from rkhs_ros.nodes.core.names import require_known_arguments
from rkhs_ros.runs.config import load_config

ABOUT = {
    "config": "parameter file with the sections /**/robot, /**/gate and /**/learner",
    "output": "folder for the results and for the episodes that the robot made",
    "resume": "true: go on with the run in the output folder, if one began there",
    "simulated": "true: start the simulated robot of the section /**/simulated_robot as well",
    "namespace": "of all nodes",
}
DEFAULTS = {"resume": "false", "simulated": "false", "namespace": ""}
AGAIN = {"respawn": True, "respawn_delay": 1.0}


def generate_launch_description() -> LaunchDescription:
    """Start gate, robot, policy and learner; all end with the learner, or with the gate.

    Robot and policy node are started again where they are killed: the learner brings them back. The gate is not: what
    it stopped for is for a person to look at.
    """
    arguments = [
        DeclareLaunchArgument(
            name, description=about, **({"default_value": DEFAULTS[name]} if name in DEFAULTS else {})
        )
        for name, about in ABOUT.items()
    ]
    return LaunchDescription([*arguments, OpaqueFunction(function=nodes)])


def nodes(context: LaunchContext) -> list[Action]:
    """Return the nodes, by the arguments of the launch file.

    Raises:
        ValueError: an argument is unknown or does not fit, or a section of the configuration does not.
    """
    require_known_arguments(sys.argv, Path(__file__).name, ABOUT)
    given = {name: LaunchConfiguration(name).perform(context) for name in ABOUT}
    for name in ("resume", "simulated"):
        require(given[name] in ("true", "false"), name, "true or false", given[name])
    config, folder = load_config(Path(given["config"])), Path(given["output"]).expanduser().resolve()
    require(bool(config.environment.nodes), given["config"], "a section /**/robot", "none")
    simulated = given["simulated"] == "true"
    require(not simulated or "simulated_robot" in config.environment.nodes, "simulated", "its section", "none")
    check_robot(config)
    file = robot_parameters(config, folder, resume=given["resume"] == "true", simulated=simulated)
    more = {"gate": {"on_exit": gate_ended}, "learner": {"on_exit": learner_ended}}
    return [
        Node(
            package="rkhs_ros",
            executable=name,
            namespace=given["namespace"],
            output="screen",
            parameters=[str(file)],
            **more.get(name, AGAIN),
        )
        for name in (*(["simulated_robot"] if simulated else []), "gate", "robot", "policy", "learner")
    ]


def gate_ended(event: ProcessExited, context: LaunchContext) -> list[Action]:
    """End the run with the gate; what is raised here makes ``ros2 launch`` end with 1."""
    if not context.is_shutdown:
        raise RuntimeError(f"the gate ended with exit code {event.returncode}; nothing may move without it")
    return []


def learner_ended(event: ProcessExited, context: LaunchContext) -> list[Action]:
    """End the others with the learner."""
    if event.returncode != 0 and not context.is_shutdown:
        raise RuntimeError(f"the learner ended with exit code {event.returncode}")
    return [Shutdown(reason="the learner is done")]
