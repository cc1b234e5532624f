"""``rkhs robot``: tell the nodes of a robot what a person decides."""

from __future__ import annotations

import argparse

from rkhs_ros.app.beside import add_folder, run_beside

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
    add_folder(parser)


def run(options: argparse.Namespace) -> int:
    """Start the node that passes the word on, and wait for its end."""
    return run_beside(options.folder, "operator", [f"word:={options.word}"])
