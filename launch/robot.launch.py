"""Launch the nodes that learn on a robot: ``ros2 launch rkhs_ros robot.launch.py config:=FILE output:=DIR``.

Start the robot's own nodes and arm the gate yourself. With ``simulated:=true``, the configuration's simulated robot
starts as well, and the gate arms itself if its settings say so. After a fault, resume the run with ``resume:=true``,
and arm the gate again.
"""

from collections.abc import Collection
from dataclasses import replace
from pathlib import Path

from launch import LaunchDescription

from rkhs_ros.app.launcher import write_parameters
from rkhs_ros.app.robots import check_robot
from rkhs_ros.base.processes import search_here
from rkhs_ros.base.validation import require
from rkhs_ros.nodes.core.launching import Given, description
from rkhs_ros.runs.config import load_config


def generate_launch_description() -> LaunchDescription:
    """Start gate, robot, policy and learner nodes."""
    return description(prepare, config=None, output=None, simulated="false")


def prepare(given: Given) -> tuple[Collection[str], Path]:
    """Write the parameter file; raise ValueError if the configuration is invalid."""
    search_here()
    config, folder = load_config(Path(given["config"])), Path(given["output"]).expanduser().resolve()
    nodes = config.environment.nodes
    require(bool(nodes), given["config"], "a section /**/robot", "none")
    simulated = given["simulated"] == "true"
    expected = "a section /**/simulated_robot in the configuration"
    require(not simulated or "simulated_robot" in nodes, "simulated", expected, "none")
    check_robot(config)
    if not simulated:
        nodes = {name: each for name, each in nodes.items() if name != "simulated_robot"}
        config = replace(config, environment=replace(config.environment, nodes=nodes))
    resume = given["resume"] == "true"
    return nodes, write_parameters(config, folder / "parameters.yaml", output=str(folder), resume=resume)
