"""``rkhs status``: show the status of the nodes of a run."""

import argparse

from rkhs_ros.app.commands.robot import add_folder, domain_in
from rkhs_ros.base.ros import require_ros


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    add_folder(parser)
    parser.add_argument("--watch", action="store_true", help="refresh every second until Ctrl-C")


def run(options: argparse.Namespace) -> int:
    """Print the status; with --watch, until Ctrl-C."""
    require_ros("status")
    domain = domain_in(options)
    from rkhs_ros.nodes.watch import show  # here, since the import needs ROS

    try:
        show(domain, watch=options.watch)
    except KeyboardInterrupt:
        if not options.watch:
            raise
    return 0
