"""``rkhs compare``: plot the learning curves of several runs, with a table of their statistics."""

import argparse
from pathlib import Path

from rich.console import Console
from rich.text import Text

import rkhs_ros.app.inline  # noqa: F401  # registers the tasks, whose known returns are plotted
from rkhs_ros.base.files import write_whole
from rkhs_ros.pictures.comparison import draw_comparison, format_of
from rkhs_ros.studies.comparison import CAPTION, Comparison, as_csv, as_markdown, as_table, compare


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    out, about = (
        Path("comparison.png"),
        "picture; the tables are written beside it as .csv and .md (default: %(default)s)",
    )
    parser.add_argument("folders", type=Path, nargs="+", metavar="DIR", help="a run's folder, or a folder of runs")
    parser.add_argument("--out", type=Path, default=out, metavar="FILE.png", help=about)


def run(options: argparse.Namespace) -> int:
    """Draw the picture, write the tables beside it, and print the table."""
    format_of(options.out)  # raises before anything is written
    comparison = compare(options.folders)
    options.out.parent.mkdir(parents=True, exist_ok=True)
    draw_comparison(options.out, comparison)
    tables = {
        options.out.with_suffix(".csv"): as_csv(comparison),
        options.out.with_suffix(".md"): as_markdown(comparison),
    }
    for path, content in tables.items():
        write_whole(path, content.encode())
    _show(comparison)
    print(f"Picture and tables: {', '.join(map(str, [options.out, *tables]))}")
    return 0


def _show(comparison: Comparison) -> None:
    """Print the table: fitted to the width of a terminal, otherwise as Markdown."""
    console = Console()
    if not console.is_terminal:
        print(comparison)
        return
    about = [CAPTION.replace("\n", " "), *comparison.notes]
    console.print(as_table(comparison), *(Text(f"\n{each}") for each in about), "", sep="\n")
