"""Arguments that name files and code. A command that gets code also searches the current folder for modules.

A file alone never extends the search: a module that a file names is imported if Python finds it.
"""

import argparse
import re
from pathlib import Path

from rkhs_ros.base.processes import search_here

OF_MODULE = re.compile(r"\w:\w")  # in MODULE:NAME
SUFFIXES = (".yaml", ".yml")  # of a configuration


def add_environment_argument(parser: argparse.ArgumentParser) -> None:
    """Declare the option that names the environment of a run, for commands that read the run from files."""
    about = "the environment of the run, MODULE:ID, if its module is in the current folder"
    parser.add_argument("--env", type=named, metavar="ID", help=about)


def path(word: str) -> Path:
    """Return an argument as a path.

    An empty argument, for example from an unset variable, would mean the current folder.

    Raises:
        ArgumentTypeError: the argument is empty.
    """
    if not word:
        raise argparse.ArgumentTypeError("expected a path, got an empty text")
    return Path(word)


def named(word: str) -> str:
    """Return an environment or a setting; if it names a module, the module may be in the current folder."""
    if OF_MODULE.search(word):
        search_here()
    return word


def configuration(word: str) -> Path:
    """Return the path of a configuration, which may name modules in the current folder."""
    search_here()
    return path(word)


def source(word: str) -> Path:
    """Return the path of a recording or a configuration."""
    return configuration(word) if word.endswith(SUFFIXES) else path(word)


def task(word: str) -> str:
    """Return an environment or the path of a configuration."""
    return str(configuration(word)) if word.endswith(SUFFIXES) else named(word)
