"""The command line that all benchmarks share: ``--quick``, and what happens if an extra is not installed."""

from __future__ import annotations

import sys
from argparse import ArgumentParser, Namespace
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from importlib.util import find_spec
from pathlib import Path
from typing import Any, NoReturn


def parser(description: str | None) -> ArgumentParser:
    """Return a parser with the option that every benchmark has."""
    command = ArgumentParser(description=description)
    command.add_argument("--quick", action="store_true", help="run in seconds, to test the script; measures nothing")
    return command


def parsed(command: ArgumentParser, arguments: Sequence[str] | None = None, **quick: Any) -> Namespace:
    """Return the options of a command line.

    Args:
        command: made by `parser`.
        arguments: of the process, if None.
        quick: defaults that ``--quick`` puts in place of the parser's.
    """
    if command.parse_args(arguments).quick:
        command.set_defaults(**quick)
    return command.parse_args(arguments)


@contextmanager
def needing(extra: str, hint: str) -> Iterator[None]:
    """Skip the benchmark if the imports in the block need a module that is not installed.

    Args:
        extra: name of the module.
        hint: how to install it.
    """
    if find_spec(extra) is None:
        skip(extra, hint)
    yield


def skip(extra: str, hint: str) -> NoReturn:
    """End the process with exit code 0 and one line on stderr that names the extra that is not installed."""
    print(f"skipped: {Path(sys.argv[0]).name}: expected {extra} to be installed. {hint}", file=sys.stderr)
    sys.exit(0)
