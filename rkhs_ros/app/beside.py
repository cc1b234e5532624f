"""A node that is started beside the run in a folder, for as long as it has something to do."""

from __future__ import annotations

import argparse
import os
from collections.abc import Iterable
from pathlib import Path

from rkhs_ros.app.domain import VARIABLE, domain_of
from rkhs_ros.app.launcher import NodeProcess, assigned
from rkhs_ros.base.ros import require_ros


def add_folder(parser: argparse.ArgumentParser) -> None:
    """Declare the argument that names the run."""
    about = "a run under way, in whose domain its nodes are found (the domain of ROS_DOMAIN_ID)"
    parser.add_argument("folder", type=Path, nargs="?", metavar="DIR", help=about)


def run_beside(folder: Path | None, node: str, parameters: Iterable[str] = ()) -> int:
    """Start a node in the domain of a run, and wait for its end.

    Args:
        folder: of the run; None for the domain of the environment.
        node: a key of `launcher.MODULES`.
        parameters: of the node, ``name:=value`` each.

    Returns:
        Its exit code.

    Raises:
        ValueError: there is no ROS, or no run under way in the folder.
        KeyboardInterrupt: as it came, after the node's end.
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
