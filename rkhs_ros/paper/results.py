"""What came of the paper's claims, as a page made from the tables of the reproduced figures."""

from __future__ import annotations

import os
from pathlib import Path

from rkhs_ros.paper.claims import CLAIMS
from rkhs_ros.paper.experiment import Experiment, load_experiment
from rkhs_ros.paper.table import Table, load_table

HEAD = """# The paper's figures, made again

Made by `rkhs results` from the tables that `rkhs reproduce` writes; do not edit. Returns are discounted and, unless
said otherwise, of the noise-free policy, means over the runs. The step sizes are ours: the paper does not say in
which units its own are. The runs of a curve have the seeds 0, 1, 2 and so on, and settings were chosen on some of them:
see [configurations](configurations.md#what-they-reach) for held-out seeds.

| Figure | The paper says | Holds | What came out |
|---|---|---|---|
"""

MENDED = (
    ("Printed", "Why it does not do", "Here"),
    ("---", "---", "---"),
    (
        "RBF kernel with the norm not squared",
        "not the RBF kernel of the text, and not smooth at the centre",
        "the norm squared",
    ),
    (
        "Eq 18 to 20: returns without a baseline",
        "their mean drowns their differences, learning stalls (above)",
        "an intercept in the regression; `baseline: as_published`",
    ),
    (
        "Eq 16, 21: the expectation of the second derivative",
        "a minus is missing",
        "the outer product, which is meant",
    ),
    (
        "E-step: p' proportional to p",
        "drops the return",
        "proportional to p R, R not negative",
    ),
    (
        "Eq 23: signed advantages as weights",
        "the system is indefinite, learning collapses (above)",
        "weights not negative; `weighting: as_published`",
    ),
    (
        "Eq 23: the inverse of the advantages",
        "infinite where an advantage is 0",
        "an equal form without that inverse",
    ),
    (
        "Eq 24: squared exploration above and below",
        "it cancels: the value is no variance",
        "a weighted mean of squared exploration, within bounds; `variance: as_published`",
    ),
    (
        "Section 3.1: the natural gradient is covariant",
        "the ridge of Eq 18 measures in the kernel's own norm, which changes with the kernel",
        "`ridge_norm: scale_free`",
    ),
)
NOTE = """
With `scale_free` covariance is exact for the polynomial kernel, whose offset leaves the space of functions the same.
Another bandwidth of the RBF kernel is another space: that RKHS-NAC is insensitive to it is a finding, not a theorem.
"""


def results(folder: Path, page: Path) -> str:
    """Return the page in Markdown.

    Args:
        folder: holds the tables and pictures.
        page: where the page will be, to which its pictures are relative.

    Raises:
        OSError: a table cannot be read.
        ValueError: it is not the table of its experiment.
    """
    tables = {name: load_table(folder / f"{name}.csv") for name in dict.fromkeys(c.figure for c in CLAIMS)}
    rows = [_row(claim.figure, claim.paper, *claim.judge(tables[claim.figure])) for claim in CLAIMS]
    place = Path(os.path.relpath(folder, page.parent))
    sections = [_section(load_experiment(name), table, place) for name, table in tables.items()]
    mended = "".join(f"| {' | '.join(row)} |\n" for row in MENDED)
    title = "\n## Where the printed formulas had to be mended\n\n"
    return HEAD + "".join(rows) + title + mended + NOTE + "".join(sections)


def _row(figure: str, paper: str, holds: bool, seen: str) -> str:
    return f"| {figure} | {paper} | {'yes' if holds else 'no'} | {seen} |\n"


def _section(experiment: Experiment, table: Table, place: Path) -> str:
    lines = [f"\n## {experiment.name}\n\n![{experiment.title}]({(place / experiment.name).as_posix()}.png)\n\n"]
    lines.append("| Plot | Curve | Runs | Iterations | Episodes | Return at the end | Worst run | sd of the runs |\n")
    lines.append("|---|---|---|---|---|---|---|---|\n")
    for (panel, curve), returns in table.items():
        last = returns.evaluation[:, -1]
        used = f"{returns.runs} | {len(returns.episodes)} | {returns.episodes[-1]:.0f}"
        lines.append(f"| {panel} | {curve} | {used} | {last.mean():.2f} | {last.min():.2f} | {last.std():.2f} |\n")
    return "".join(lines)
