"""``rkhs robot``: send an operator command to the nodes of a robot."""

import argparse

from rkhs_ros.app.beside import add_folder, run_beside

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
