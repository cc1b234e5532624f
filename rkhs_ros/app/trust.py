"""Which code the commands may import: what a person names, and what is installed."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from functools import wraps

from rkhs_ros.base.user_code import only_installed

Run = Callable[[argparse.Namespace], int]


def add_trust_argument(parser: argparse.ArgumentParser) -> None:
    """Declare the option that lets data files name modules that are not installed."""
    parser.add_argument("--trust", action="store_true", help="import from this folder, too, the modules that it names")


def reads_data(run: Run) -> Run:
    """Have a command import none but installed modules, unless its options trust the data files that it reads.

    The module of its option ``--env`` is trusted, for a person named it.
    """

    @wraps(run)
    def limited(options: argparse.Namespace) -> int:
        if getattr(options, "trust", False):
            return run(options)
        environment = getattr(options, "env", None) or ""
        with only_installed(environment.rpartition(":")[0]):
            return run(options)

    return limited
