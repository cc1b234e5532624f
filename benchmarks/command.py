"""Share the command line of the benchmarks, ``--quick``, and measure times."""

import math
import signal
import sys
from argparse import ArgumentParser, Namespace
from collections.abc import Callable, Sequence
from pathlib import Path
from statistics import median
from tempfile import mkdtemp
from timeit import repeat
from typing import Any

from rkhs_ros.base.endings import INTERRUPTED, RunError, print_error
from rkhs_ros.base.validation import require

FILES = {"curves", "out"}  # options that name a file for the results


def parser(description: str | None) -> ArgumentParser:
    """Return a parser with the option ``--quick``."""
    command = ArgumentParser(description=description)
    command.add_argument("--quick", action="store_true", help="test the script in seconds; the figures mean nothing")
    return command


def parsed(command: ArgumentParser, arguments: Sequence[str] | None = None, **quick: Any) -> Namespace:
    """Parse a command line and return its options.

    Args:
        command: made by `parser`.
        arguments: the arguments; those of the process if None.
        quick: defaults that ``--quick`` uses instead of the parser's.

    Raises:
        ValueError: a file is given for the figures of ``--quick``.
    """
    options = command.parse_args(arguments)
    if not options.quick:
        return options
    for file in FILES & vars(options).keys():
        require(getattr(options, file) == command.get_default(file), "--quick", "no file for its figures", f"--{file}")
    if hasattr(options, "curves"):
        command.set_defaults(curves=Path(mkdtemp(), "curves.csv"))
    command.set_defaults(**quick)
    return command.parse_args(arguments)


def ended(run: Callable[[], int | None]) -> int:
    """Run a command; print an error, or that it was interrupted, in one line, and return its exit code."""
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        return run() or 0
    except (ValueError, OSError, RunError) as error:
        return print_error(error)
    except KeyboardInterrupt:
        print("interrupted; finished runs are stored", file=sys.stderr)
        return INTERRUPTED


def seconds_of(call: Callable[[], object], repeats: int, number: int = 1) -> float:
    """Return the median over repeats of the mean time of a number of calls, after a warm-up call."""
    call()
    return median(repeat(call, number=number, repeat=repeats)) / number


def growth(amounts: dict[int, float], first: int, last: int) -> float:
    """Return the exponent of growth from the first to the last number of samples."""
    return math.log(amounts[last] / amounts[first]) / math.log(last / first)
