"""Trust model of the commands: they import only installed modules and modules that the user names."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from functools import wraps

from rkhs_ros.base.user_code import only_installed

Run = Callable[[argparse.Namespace], int]


def add_trust_argument(parser: argparse.ArgumentParser) -> None:
    """Declare the option that allows data files to name modules that are not installed."""
    about = "allow the data file to import modules that are not installed, from the current folder"
    parser.add_argument("--trust", action="store_true", help=about)


def reads_data(run: Run) -> Run:
    """Decorate a command so that it imports only installed modules, unless --trust is given.

    The module of the option ``--env`` is trusted, since the user named it.
    """

    @wraps(run)
    def limited(options: argparse.Namespace) -> int:
        if getattr(options, "trust", False):
            return run(options)
        environment = getattr(options, "env", None) or ""
        with only_installed(environment.rpartition(":")[0]):
            return run(options)

    return limited
