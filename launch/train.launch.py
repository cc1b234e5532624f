"""Launch the nodes of a run: ``ros2 launch rkhs_ros train.launch.py config:=FILE``.

After a fault, resume the run with ``resume:=true``.
"""

from pathlib import Path

from launch import LaunchDescription
from launch.substitutions import PathJoinSubstitution
from launch_ros.substitutions import FindPackageShare

from rkhs_ros.app.launcher import write_parameters
from rkhs_ros.base.validation import require
from rkhs_ros.nodes.core.launching import Given, description
from rkhs_ros.runs.config import load_config
from rkhs_ros.runs.report import new_folder


def generate_launch_description() -> LaunchDescription:
    """Start simulator, policy and learner nodes; without an output folder, the results are in results/NAME/TIME."""
    file = PathJoinSubstitution([FindPackageShare("rkhs_ros"), "config", "pendulum_nac.yaml"])
    return description(prepare, config=file, output="")


def prepare(given: Given) -> tuple[tuple[()], Path]:
    """Write the parameter file; raise ValueError if the configuration is invalid."""
    config = load_config(Path(given["config"]))
    require(not config.environment.nodes, given["config"], "a section /**/simulator", "a robot")
    folder = (
        Path(given["output"]).expanduser() if given["output"] else new_folder(None, config.training.name)
    ).resolve()
    resume = given["resume"] == "true"
    return (), write_parameters(config, folder / "parameters.yaml", output=str(folder), resume=resume)
