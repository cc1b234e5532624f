"""``rkhs status``: show what the nodes of a run report."""

from __future__ import annotations

import argparse

from rkhs_ros.app.launcher import NodeProcess


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments: none."""


def run(options: argparse.Namespace) -> int:
    """Start the node that listens to the others, and wait for its end."""
    return NodeProcess("status").process.wait()
