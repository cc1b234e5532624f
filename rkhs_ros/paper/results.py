"""Page of results: the paper's claims, checked against the tables of the reproduced figures."""

from __future__ import annotations

import os
from pathlib import Path

from rkhs_ros.paper.claims import CLAIMS
from rkhs_ros.paper.experiment import Experiment, load_experiment
from rkhs_ros.paper.table import Table, load_table

HEAD = """# Results: the paper's claims

`rkhs results` generated this page from the tables of the [reproduced figures](paper.md); do not edit it. Unless stated
otherwise, returns are discounted evaluation returns (policy mean, no exploration noise), averaged over the runs.

The runs of a curve have the seeds 0, 1, 2 and so on. Settings were chosen on some of these seeds. For results on
held-out seeds, see [configurations](configurations.md#what-they-reach). The paper does not state the units of its step
sizes, so this project chose its own.

| Figure | Claim of the paper | Holds | Result |
|---|---|---|---|
"""

CORRECTED = (
    ("As published", "Problem", "Here"),
    ("---", "---", "---"),
    (
        "RBF kernel with the norm not squared",
        "not the RBF kernel that the text names, and not smooth at the centre",
        "the norm squared",
    ),
    (
        "Eq 18 to 20: returns without a baseline",
        "their mean dominates their differences, and learning stalls (above)",
        "an intercept in the regression; `baseline: as_published` for the original",
    ),
    (
        "Eq 16, 21: the expectation of the second derivative",
        "a minus sign is missing",
        "the outer product, which is equal to the intended expression",
    ),
    (
        "E-step: p' proportional to p",
        "the return is missing",
        "proportional to p R, with nonnegative R",
    ),
    (
        "Eq 23: signed advantages as weights",
        "the system is indefinite, and learning collapses (above)",
        "nonnegative weights; `weighting: as_published` for the original",
    ),
    (
        "Eq 23: the inverse of the advantages",
        "infinite if an advantage is 0",
        "an equivalent form without that inverse",
    ),
    (
        "Eq 24: squared exploration in numerator and denominator",
        "the squared exploration cancels, and the result is not a variance",
        "a weighted mean of squared exploration, within bounds; `variance: as_published` for the original",
    ),
    (
        "Section 3.1: the natural gradient is covariant",
        "the ridge of Eq 18 penalises the RKHS norm, which depends on the kernel",
        "`ridge_norm: scale_free`",
    ),
)
NOTE = """
With `scale_free`, covariance is exact for the offset of the polynomial kernel, because the offset does not change the
function space. The bandwidth of the RBF kernel does change it, so insensitivity to the bandwidth is an observation, not
a theorem.
"""


def results(folder: Path, page: Path) -> str:
    """Return the page in Markdown.

    Args:
        folder: folder of the tables and pictures.
        page: path of the page, to which the paths of the pictures are relative.

    Raises:
        OSError: a table cannot be read.
        ValueError: a file is not the table of its experiment.
    """
    tables = {name: load_table(folder / f"{name}.csv") for name in dict.fromkeys(c.figure for c in CLAIMS)}
    rows = [_row(claim.figure, claim.paper, *claim.judge(tables[claim.figure])) for claim in CLAIMS]
    place = Path(os.path.relpath(folder, page.parent))
    sections = [_section(load_experiment(name), table, place) for name, table in tables.items()]
    corrected = "".join(f"| {' | '.join(row)} |\n" for row in CORRECTED)
    title = "\n## Corrected formulas\n\n"
    return HEAD + "".join(rows) + title + corrected + NOTE + "".join(sections)


def _row(figure: str, paper: str, holds: bool, observed: str) -> str:
    return f"| {figure} | {paper} | {'yes' if holds else 'no'} | {observed} |\n"


def _section(experiment: Experiment, table: Table, place: Path) -> str:
    lines = [f"\n## {experiment.name}\n\n![{experiment.title}]({(place / experiment.name).as_posix()}.png)\n\n"]
    lines.append("| Plot | Curve | Runs | Iterations | Episodes | Return at the end | Worst run | sd of the runs |\n")
    lines.append("|---|---|---|---|---|---|---|---|\n")
    for (panel, curve), returns in table.items():
        last = returns.evaluation[:, -1]
        used = f"{returns.runs} | {len(returns.episodes)} | {returns.episodes[-1]:.0f}"
        lines.append(f"| {panel} | {curve} | {used} | {last.mean():.2f} | {last.min():.2f} | {last.std():.2f} |\n")
    return "".join(lines)
