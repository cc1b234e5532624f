"""``rkhs robot``: tell the nodes of a robot what a person decides."""

from __future__ import annotations

import argparse
import os
from importlib.util import find_spec
from pathlib import Path

from rkhs_ros.app.domain import VARIABLE, domain_of
from rkhs_ros.app.launcher import NodeProcess, assigned
from rkhs_ros.base.validation import require

WORDS = {
    "arm": "the gate may pass commands on: the robot may move",
    "stop": "the gate brings the robot to rest, until it is armed again",
    "start": "the scene is in order, or the pause is over",
    "pause": "no further episode begins",
    "veto": "the last finished episode counts for nothing",
}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    words = "; ".join(f"{word}: {about}" for word, about in WORDS.items())
    parser.add_argument("word", choices=WORDS, metavar="WORD", help=words)
    about = "a run under way, in whose domain the nodes are (the domain of ROS_DOMAIN_ID)"
    parser.add_argument("folder", type=Path, nargs="?", metavar="DIR", help=about)


def run(options: argparse.Namespace) -> int:
    """Start the node that passes the word on, and wait for its end.

    Raises:
        ValueError: there is no ROS.
    """
    require(find_spec("rclpy") is not None, "rkhs robot", "ROS 2, on which robots listen", "none")
    if options.folder is not None:
        os.environ[VARIABLE] = domain_of(options.folder)
    return NodeProcess("operator", assigned([f"word:={options.word}"])).process.wait()
