"""``rkhs plot``: plot the learning curve and the policy of a run from its folder."""

import argparse
from pathlib import Path

import rkhs_ros.app.inline  # noqa: F401  # registers the tasks, whose known returns are plotted
from rkhs_ros.app.named import add_environment_argument
from rkhs_ros.pictures.run_pictures import draw_run
from rkhs_ros.runs.report import last_policy


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    parser.add_argument("folder", type=Path, metavar="DIR", help="a run's folder")
    add_environment_argument(parser)


def run(options: argparse.Namespace) -> int:
    """Draw curve.png and policy.png, and print their paths."""
    for picture in draw_run(last_policy(options.folder).parent):
        print(picture)
    return 0
