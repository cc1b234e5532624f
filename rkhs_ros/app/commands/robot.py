"""``rkhs robot`` and ``rkhs status``: send an operator command to the nodes of a run, and show their status."""

import argparse
from pathlib import Path

from rkhs_ros.app.launcher import domain_of
from rkhs_ros.base.validation import require_ros

WORDS = {
    "arm": "let the gate forward commands, so that the robot can move",
    "stop": "bring the robot to rest until it is armed again",
    "start": "confirm that the scene is ready, or end a pause",
    "pause": "start no further episode",
    "veto": "discard the last finished episode",
}
FOLDER = "folder of an active run, which names the ROS domain of its nodes (default: domain of ROS_DOMAIN_ID)"


def add_robot(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of ``rkhs robot``."""
    words = "; ".join(f"{word}: {about}" for word, about in WORDS.items())
    parser.add_argument("word", choices=WORDS, metavar="WORD", help=words)
    parser.add_argument("folder", type=Path, nargs="?", metavar="DIR", help=FOLDER)


def run_robot(options: argparse.Namespace) -> int:
    """Send the command, and print the answer."""
    require_ros("robot")
    from rkhs_ros.nodes.watch import command  # here, since the import needs ROS

    print(command(options.word, _domain(options)))
    return 0


def add_status(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of ``rkhs status``."""
    parser.add_argument("folder", type=Path, nargs="?", metavar="DIR", help=FOLDER)
    parser.add_argument("--watch", action="store_true", help="refresh every second until Ctrl-C")


def run_status(options: argparse.Namespace) -> int:
    """Print the status; with --watch, until Ctrl-C."""
    require_ros("status")
    from rkhs_ros.nodes.watch import show  # here, since the import needs ROS

    try:
        show(_domain(options), watch=options.watch)
    except KeyboardInterrupt:
        if not options.watch:
            raise
    return 0


def _domain(options: argparse.Namespace) -> int | None:
    """Return the ROS domain of the active run that the arguments name; None for that of ROS_DOMAIN_ID."""
    return domain_of(options.folder) if options.folder is not None else None
