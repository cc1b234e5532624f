"""``rkhs robot``: send an operator command to the nodes of a robot."""

import argparse
import os
from collections.abc import Iterable
from pathlib import Path

from rkhs_ros.app.domain import VARIABLE, domain_of
from rkhs_ros.app.launcher import NodeProcess, assigned
from rkhs_ros.base.ros import require_ros

WORDS = {
    "arm": "let the gate forward commands, so that the robot can move",
    "stop": "bring the robot to rest until it is armed again",
    "start": "confirm that the scene is ready, or end a pause",
    "pause": "start no further episode",
    "veto": "discard the last finished episode",
}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    words = "; ".join(f"{word}: {about}" for word, about in WORDS.items())
    parser.add_argument("word", choices=WORDS, metavar="WORD", help=words)
    add_folder(parser)


def run(options: argparse.Namespace) -> int:
    """Start the node that sends the command, and wait until it ends."""
    return run_beside(options.folder, "operator", [f"word:={options.word}"])


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
