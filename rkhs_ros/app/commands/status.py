"""``rkhs status``: show the status of the nodes of a run."""

import argparse

from rkhs_ros.app.commands.robot import add_folder, run_beside


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    add_folder(parser)
    parser.add_argument("--watch", action="store_true", help="refresh every second until Ctrl-C")


def run(options: argparse.Namespace) -> int:
    """Start the status node and wait until it ends; with --watch, until Ctrl-C."""
    try:
        return run_beside(options.folder, "status", [f"watch:={str(options.watch).lower()}"])
    except KeyboardInterrupt:
        if options.watch:
            return 0
        raise
