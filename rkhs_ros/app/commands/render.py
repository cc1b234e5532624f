"""``rkhs render``: render an evaluation episode."""

import argparse
from pathlib import Path

from rkhs_ros.app.inline import load_acting
from rkhs_ros.app.named import add_environment_argument
from rkhs_ros.app.robots import robot_of
from rkhs_ros.base.validation import require
from rkhs_ros.pictures.film import USUAL, animate, draw_strip, shoot


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    parser.add_argument("policy", type=Path, metavar="DIR|FILE", help="a run's folder, or a policy file")
    parser.add_argument(
        "--out", type=Path, metavar="DIR", help="folder for film.png and film.gif (default: that of the policy)"
    )
    parser.add_argument(
        "--seed", type=int, default=0, metavar="N", help="seed of all randomness (default: %(default)s)"
    )
    parser.add_argument(
        "--frames", type=int, default=USUAL, metavar="N", help="maximum number of pictures (default: %(default)s)"
    )
    add_environment_argument(parser)


def run(options: argparse.Namespace) -> int:
    """Write the film strip and the animation, and print their paths."""
    require(
        robot_of(options.policy) is None,
        f"{options.policy}",
        "a run in simulation",
        f"one on a robot. Use rkhs evaluate {options.policy} to run episodes, rkhs view {options.policy} to show them",
    )
    with load_acting(options.policy, options.env) as acting:
        film = shoot(*acting, seed=options.seed, frames=options.frames)
    folder = options.out or (options.policy if options.policy.is_dir() else options.policy.parent)
    folder.mkdir(parents=True, exist_ok=True)
    for write, name in ((draw_strip, "film.png"), (animate, "film.gif")):
        write(folder / name, film)
        print(folder / name)
    return 0
