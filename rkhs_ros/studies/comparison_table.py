"""Tables of a comparison: CSV with all digits, and Markdown or a terminal table for readers."""

from __future__ import annotations

import csv
from collections.abc import Iterator, Sequence
from io import StringIO
from typing import Any

import numpy as np
from rich.table import Table
from rich.text import Text

from rkhs_ros.base.validation import truncated
from rkhs_ros.studies.aggregates import Estimate
from rkhs_ros.studies.comparison import Comparison, LearningCurve

CAPTION = (
    "Discounted evaluation returns unless noted otherwise. Brackets show 95 % intervals over the runs by stratified\n"
    "bootstrap. The interquartile mean and the median are those of the final returns. The area under the curve is the\n"
    "mean return over the exploration episodes."
)


def as_csv(comparison: Comparison) -> str:
    """Return the table as CSV with one line per curve; the interval of a single run is empty."""
    lines = [dict(_numbers(_row(curve))) for curve in comparison.curves]
    text = StringIO(newline="")
    writer = csv.DictWriter(text, list(lines[0]), lineterminator="\n")
    writer.writeheader()
    writer.writerows(lines)
    return text.getvalue()


def as_markdown(comparison: Comparison) -> str:
    """Return the table as Markdown with aligned columns, followed by the caption and the notes."""
    rows = [_row(curve) for curve in comparison.curves]
    head = [name.replace("_", " ") for name in rows[0]]
    body = [[_text(value) for value in row.values()] for row in rows]
    widths = [max(map(len, column)) for column in zip(head, *body, strict=True)]
    lines = [_line(head, widths), _line(["-" * width for width in widths], widths), *(_line(r, widths) for r in body)]
    return "\n".join([*lines, "", CAPTION, *(f"\n{note}" for note in comparison.notes), ""])


def as_table(comparison: Comparison) -> Table:
    """Return the table for a terminal, narrow enough for 80 columns."""
    rows = [_row(curve) for curve in comparison.curves]
    table = Table(box=None, pad_edge=False)
    for name in rows[0]:
        table.add_column(name.replace("_", "\n"), no_wrap=name != "curve", overflow="fold")
    for row in rows:
        label, *values = row.values()
        table.add_row(Text(truncated(label)), *(Text(_plain(value).replace(" ", "\n")) for value in values))
    return table


def _row(curve: LearningCurve) -> dict[str, Any]:
    runs, episodes = len(curve.returns), float(curve.episodes[-1])
    return {"curve": curve.label, "runs": runs, "episodes": episodes, **vars(curve.aggregates())}


def _numbers(row: dict[str, Any]) -> Iterator[tuple[str, object]]:
    """Yield the entries of a row by column, with separate columns for the bounds of an estimate."""
    for name, value in row.items():
        if not isinstance(value, Estimate):
            yield name, value
            continue
        yield name, value.value
        for bound in ("low", "high"):
            number = getattr(value, bound)
            yield f"{name}_{bound}", "" if np.isnan(number) else number


def _plain(value: object) -> str:
    return f"{value:.5g}" if isinstance(value, float) else str(value)


def _text(value: object) -> str:
    return _plain(value).replace("|", "\\|")


def _line(words: Sequence[str], widths: Sequence[int]) -> str:
    return f"| {' | '.join(word.ljust(width) for word, width in zip(words, widths, strict=True))} |"
