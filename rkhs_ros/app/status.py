"""``rkhs status``: show what the nodes of a run report."""

from __future__ import annotations

import argparse
import os
from pathlib import Path

from rkhs_ros.app.domain import VARIABLE, domain_of
from rkhs_ros.app.launcher import NodeProcess


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    about = "a run under way, in whose domain to listen (the domain of ROS_DOMAIN_ID)"
    parser.add_argument("folder", type=Path, nargs="?", metavar="DIR", help=about)


def run(options: argparse.Namespace) -> int:
    """Start the node that listens to the others, and wait for its end."""
    if options.folder is not None:
        os.environ[VARIABLE] = domain_of(options.folder)
    return NodeProcess("status").process.wait()
