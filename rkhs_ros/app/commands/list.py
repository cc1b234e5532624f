"""``rkhs list``: list the tasks, algorithms, kernels and figures."""

import argparse
from collections.abc import Iterable

import gymnasium

import rkhs_ros.app.inline  # noqa: F401  # registers the tasks
from rkhs_ros.learning.algorithms.registry import ALGORITHMS
from rkhs_ros.learning.kernel_choice import KERNELS
from rkhs_ros.paper.experiment import known

OUR_NAMESPACE = "rkhs/"  # of the ids of our tasks
REMOTE = "rkhs/Remote-v0"  # stands for any task that runs in another process


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments: none."""


def run(options: argparse.Namespace) -> int:
    """Print the tasks, algorithms, kernels and figures."""
    tasks = [name for name in gymnasium.registry if name.startswith(OUR_NAMESPACE) and name != REMOTE]
    kinds: dict[str, Iterable[str]] = {"tasks": tasks, "algorithms": ALGORITHMS, "kernels": KERNELS, "figures": known()}
    for title, names in kinds.items():
        print(f"{title}: {', '.join(names)}")
    print("Any other Gymnasium environment with continuous actions can also be used, by its id.")
    return 0
