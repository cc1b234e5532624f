"""Auxiliary nodes of a run, such as the status node, which run until their task is done."""

import argparse
import os
from collections.abc import Iterable
from pathlib import Path

from rkhs_ros.app.domain import VARIABLE, domain_of
from rkhs_ros.app.launcher import NodeProcess, assigned
from rkhs_ros.base.ros import require_ros


def add_folder(parser: argparse.ArgumentParser) -> None:
    """Declare the argument that names the run."""
    about = "folder of an active run, which names the ROS domain of its nodes (default: domain of ROS_DOMAIN_ID)"
    parser.add_argument("folder", type=Path, nargs="?", metavar="DIR", help=about)


def run_beside(folder: Path | None, node: str, parameters: Iterable[str] = ()) -> int:
    """Start a node in the ROS domain of a run, and wait until it ends.

    Args:
        folder: folder of the run; None for the domain of ROS_DOMAIN_ID.
        node: a key of `launcher.MODULES`.
        parameters: parameters of the node, each ``name:=value``.

    Returns:
        Exit code of the node.

    Raises:
        ValueError: ROS is missing, or the folder has no active run.
        KeyboardInterrupt: Ctrl-C, after the node ended.
    """
    require_ros(f"{node} node")
    if folder is not None:
        os.environ[VARIABLE] = domain_of(folder)
    process = NodeProcess(node, assigned(parameters)).process
    try:
        return process.wait()
    except KeyboardInterrupt:
        process.terminate()
        process.wait()
        raise
