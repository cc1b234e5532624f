"""``rkhs status``: show what the nodes of a run report."""

from __future__ import annotations

import argparse
from importlib.util import find_spec

from rkhs_ros.app.launcher import NodeProcess
from rkhs_ros.base.validation import require


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments: none."""


def run(options: argparse.Namespace) -> int:
    """Start the node that listens to the others, and wait for its end.

    Raises:
        ValueError: there is no ROS.
    """
    require(find_spec("rclpy") is not None, "rkhs status", "ROS 2, on which nodes report", "none")
    return NodeProcess("status").process.wait()
