"""``rkhs robot``: send an operator command to the nodes of a robot."""

import argparse
from pathlib import Path

from rkhs_ros.app.domain import domain_of
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
    """Send the command, and print the answer."""
    require_ros("robot")
    domain = domain_in(options)
    from rkhs_ros.nodes.watch import command  # here, since the import needs ROS

    print(command(options.word, domain))
    return 0


def add_folder(parser: argparse.ArgumentParser) -> None:
    """Declare the argument that names the run."""
    about = "folder of an active run, which names the ROS domain of its nodes (default: domain of ROS_DOMAIN_ID)"
    parser.add_argument("folder", type=Path, nargs="?", metavar="DIR", help=about)


def domain_in(options: argparse.Namespace) -> int | None:
    """Return the ROS domain of the run that the arguments name; None for that of ROS_DOMAIN_ID.

    Raises:
        ValueError: the folder has no active run.
    """
    return int(domain_of(options.folder)) if options.folder is not None else None
