"""``rkhs status``: show what the nodes of a run report."""

from __future__ import annotations

import argparse
import os
from importlib.util import find_spec
from pathlib import Path

from rkhs_ros.app.domain import VARIABLE, domain_of
from rkhs_ros.app.launcher import NodeProcess
from rkhs_ros.base.validation import require


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    about = "a run under way, in whose domain to listen (the domain of ROS_DOMAIN_ID)"
    parser.add_argument("folder", type=Path, nargs="?", metavar="DIR", help=about)


def run(options: argparse.Namespace) -> int:
    """Start the node that listens to the others, and wait for its end.

    Raises:
        ValueError: there is no ROS.
    """
    require(find_spec("rclpy") is not None, "rkhs status", "ROS 2, on which nodes report", "none")
    if options.folder is not None:
        os.environ[VARIABLE] = domain_of(options.folder)
    return NodeProcess("status").process.wait()
