"""``rkhs compare``: draw the learning curves of several runs, with a table of what they come to."""

from __future__ import annotations

import argparse
from pathlib import Path

import rkhs_ros.app.inline  # noqa: F401  # registers the tasks, whose known returns are drawn
from rkhs_ros.base.files import write_whole
from rkhs_ros.pictures.comparison import draw_comparison, format_of
from rkhs_ros.runs.comparison import compare
from rkhs_ros.runs.comparison_table import as_csv, as_markdown


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    out, about = Path("comparison.png"), "picture, beside which go the tables .csv and .md (%(default)s)"
    parser.add_argument("folders", type=Path, nargs="+", metavar="DIR", help="a run, or a folder that holds runs")
    parser.add_argument("--out", type=Path, default=out, metavar="FILE.png", help=about)


def run(options: argparse.Namespace) -> int:
    """Draw the picture, write the tables beside it, and print them."""
    format_of(options.out)  # refused before anything is written
    comparison = compare(options.folders)
    table = as_markdown(comparison)
    options.out.parent.mkdir(parents=True, exist_ok=True)
    draw_comparison(options.out, comparison)
    tables = {options.out.with_suffix(".csv"): as_csv(comparison), options.out.with_suffix(".md"): table}
    for path, content in tables.items():
        write_whole(path, content.encode())
    print(table)
    print(f"Picture and tables: {', '.join(map(str, [options.out, *tables]))}")
    return 0
