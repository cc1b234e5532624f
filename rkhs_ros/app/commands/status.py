"""``rkhs status``: show what the nodes of a run report."""

from __future__ import annotations

import argparse

from rkhs_ros.app.beside import add_folder, run_beside


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    add_folder(parser)
    parser.add_argument("--watch", action="store_true", help="show it anew each second, until Ctrl-C")


def run(options: argparse.Namespace) -> int:
    """Start the node that listens to the others, and wait for its end, which of a watch is Ctrl-C."""
    try:
        return run_beside(options.folder, "status", [f"watch:={str(options.watch).lower()}"])
    except KeyboardInterrupt:
        if options.watch:
            return 0
        raise
