"""``rkhs results``: judge the paper's claims by the tables of the reproduced figures."""

from __future__ import annotations

import argparse
from pathlib import Path

from rkhs_ros.paper.results import results


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    parser.add_argument("folder", type=Path, metavar="DIR", help="folder with the figures' csv files")
    parser.add_argument("--out", type=Path, default=Path("results.md"), metavar="FILE", help="the page (%(default)s)")


def run(options: argparse.Namespace) -> int:
    """Write the page, and print where it is."""
    options.out.write_text(results(options.folder, options.out))
    print(options.out)
    return 0
