"""``rkhs simulate``: run a simulator, or the nodes of a robot, for learners of other libraries."""

import argparse
import os
import sys
from pathlib import Path
from tempfile import TemporaryDirectory

from rkhs_ros.app.domain import VARIABLE
from rkhs_ros.app.inline import spaces_of, untuned_config
from rkhs_ros.app.launcher import launch_worlds, write_parameters
from rkhs_ros.app.named import configuration, named
from rkhs_ros.app.robots import check_robot
from rkhs_ros.base.ros import require_ros
from rkhs_ros.base.validation import require
from rkhs_ros.runs.config import Config, load_config


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    add = parser.add_argument
    add(
        "config",
        type=configuration,
        nargs="?",
        metavar="CONFIG",
        help="YAML file of a simulator or a robot; see config/",
    )
    add("--env", type=named, metavar="ID", help="an environment instead of CONFIG (module:Id-v0 imports the module)")
    about = "settings to replace, such as robot.period=0.1"
    add("--set", nargs="+", type=named, action="extend", default=[], metavar="KEY=VALUE", help=about)


def run(options: argparse.Namespace) -> int:
    """Run the nodes until Ctrl-C, or until one of them exits.

    Raises:
        ValueError: ROS is missing, or the task cannot be served.
    """
    require_ros("rkhs simulate")
    config = _configuration(options)
    if config.environment.nodes:
        check_robot(config)
    else:
        spaces_of(config.environment)
    config.check_for_topics()
    domain = os.environ.setdefault(VARIABLE, "0")
    print(f"{config.environment.id} in ROS domain {domain}; stop with Ctrl-C", file=sys.stderr)
    with TemporaryDirectory() as place:
        return launch_worlds(config, write_parameters(config, Path(place) / "parameters.yaml"))


def _configuration(options: argparse.Namespace) -> Config:
    given = " and ".join(name for name in ("CONFIG", "--env") if getattr(options, name.strip("-").lower()))
    require(given in ("CONFIG", "--env"), "simulate", "either CONFIG or --env ID", given or "none")
    return load_config(options.config, options.set) if options.config else untuned_config(options.env, options.set)
