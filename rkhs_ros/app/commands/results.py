"""``rkhs results``: check the claims of the paper against the tables of the reproduced figures."""

from __future__ import annotations

import argparse
from pathlib import Path

from rkhs_ros.paper.results import results


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    parser.add_argument("folder", type=Path, metavar="DIR", help="folder with the CSV files of the figures")
    parser.add_argument(
        "--out", type=Path, default=Path("results.md"), metavar="FILE", help="page to write (default: %(default)s)"
    )


def run(options: argparse.Namespace) -> int:
    """Write the page and print its path."""
    options.out.write_text(results(options.folder, options.out))
    print(options.out)
    return 0
