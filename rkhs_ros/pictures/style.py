"""How pictures look: colours that the colour-blind tell apart, text that fits, legends beside what they explain."""

from __future__ import annotations

from collections.abc import Iterable
from io import BytesIO
from itertools import cycle, product
from pathlib import Path
from textwrap import wrap
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.cm import ScalarMappable
from matplotlib.figure import Figure
from matplotlib.font_manager import FontProperties
from matplotlib.layout_engine import ConstrainedLayoutEngine
from matplotlib.textpath import text_to_path
from matplotlib.ticker import Formatter, MaxNLocator
from numpy.typing import NDArray

from rkhs_ros.base.files import write_whole

# Okabe and Ito's colours, which the colour-blind tell apart; yellow last, which is faint on white.
COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#56B4E9", "#E69F00", "#000000", "#F0E442")
MARKERS = ("o", "s", "^", "D", "v", "P", "X", "*")  # tell them apart in black and white
STYLES = ("-", "-.", ":")  # another one for every eight curves; that of a known return is "--"
SIGNED, UNSIGNED = "coolwarm", "viridis"  # maps in which equal steps look equal, to the colour-blind, too
REFERENCE_GREYS = ("0.2", "0.45", "0.65")  # of known returns
DPI = 120
POINTS = 72  # in an inch
SPARE = 0.92  # part of a line that is filled, since some of a text's lines have more wide letters
TITLE_SIZE, LABEL_SIZE, SMALL_SIZE = 11, 10, 9  # points
MARGIN_IN = 0.8  # beside a plot at most, but for the one of colours
BAR_IN = 0.9  # of the one of colours, with its numbers and name
LINE_IN = 0.55  # inches of the line before a legend's entry
TICKS_PER_INCH, FEWEST_TICKS, MOST_TICKS = (1.3, 1.8), 2, 8  # of the x and the y axis
TICK_STEPS = (1, 2, 2.5, 5, 10)
FEWEST_DIGITS, MOST_DIGITS = 6, 15


class Plain(Formatter):
    """Writes each tick whole, with as many digits as tell it from the others, so that no factor stands apart."""

    def __call__(self, x: float, pos: int | None = None) -> str:
        """Return the text of a tick."""
        digits = range(FEWEST_DIGITS, MOST_DIGITS)
        told = (d for d in digits if len({f"{place:.{d}g}" for place in self.locs}) == len(set(self.locs)))
        return f"{x:.{next(told, MOST_DIGITS)}g}".replace("-", "\N{MINUS SIGN}")


def sheet(width: float, height: float, title: str = "") -> Figure:
    """Return a white figure of a size in inches, under a title that is broken to fit."""
    layout = ConstrainedLayoutEngine(w_pad=0.06, h_pad=0.06)
    figure = Figure(figsize=(width, height), layout=layout, facecolor="white")
    if title:
        lines = [folded(line, width, TITLE_SIZE) for line in title.splitlines()]
        figure.suptitle("\n".join(lines), fontsize=TITLE_SIZE)
    return figure


def pixels(figure: Figure) -> NDArray[np.uint8]:
    """Draw a figure and return its pixels, RGB of shape (height, width, 3)."""
    canvas: Any = FigureCanvasAgg(figure)
    canvas.draw()
    return np.array(canvas.buffer_rgba())[:, :, :3]


def label(axes: Axes, x: str, y: str, title: str = "") -> None:
    """Name the axes of a plot, and the plot, in as many lines as they need."""
    width, height = _size(axes)
    axes.set_xlabel(folded(x, width), fontsize=LABEL_SIZE)
    axes.set_ylabel(folded(y, height), fontsize=LABEL_SIZE)
    if title:
        axes.set_title(folded(title, width, LABEL_SIZE), fontsize=LABEL_SIZE)
    axes.set_facecolor("white")
    axes.spines[["top", "right"]].set_visible(False)
    for axis, inches, per_inch in zip((axes.xaxis, axes.yaxis), (width, height), TICKS_PER_INCH, strict=True):
        most = int(min(max(inches * per_inch, FEWEST_TICKS), MOST_TICKS))
        axis.set_major_locator(MaxNLocator(most, steps=TICK_STEPS))
        axis.set_major_formatter(Plain())


def whole_ticks(axes: Axes) -> None:
    """Let the axis across count in whole numbers."""
    locator: Any = axes.xaxis.get_major_locator()
    locator.set_params(integer=True, min_n_ticks=1)


def colour_bar(axes: Axes, image: ScalarMappable, name: str) -> None:
    """Explain the colours of a plot beside it."""
    bar = axes.figure.colorbar(image, ax=axes, format=Plain())
    bar.set_label(folded(name, _size(axes)[1]), fontsize=LABEL_SIZE)


def _size(axes: Axes) -> tuple[float, float]:
    """Return width and height, in inches, that a plot has about, before texts are laid out."""
    figure: Any = axes.figure
    place = axes.get_subplotspec()
    width, height = figure.get_size_inches()
    part = axes.get_position() if place is None else place.get_position(figure)
    return width * part.width, height * part.height


def folded(text: str, inches: float, size: float = LABEL_SIZE) -> str:
    """Return a text in lines that fit into some inches in a font of some points."""
    count = SPARE * inches / max(width_of(text, size), 1e-9) * len(text)
    return text if count >= len(text) else "\n".join(wrap(text, max(int(count), 8)))


def width_of(text: str, size: float) -> float:
    """Return the inches that the longest line of a text takes in a font of some points."""
    font = FontProperties(size=size)
    measured = (text_to_path.get_text_width_height_descent(line, font, ismath=False) for line in text.splitlines())
    return max((float(width) for width, _, _ in measured), default=0.0) / POINTS


def legend_above(axes: Axes, title: str = "") -> None:
    """Explain a plot's lines above it, where they cover nothing, under a title of the plot."""
    handles, names = axes.get_legend_handles_labels()
    figure, grid = axes.figure, axes.get_gridspec()
    is_coloured = any(each.colorbar is not None for each in (*axes.collections, *axes.images))
    room = figure.bbox.width / figure.dpi / (grid.ncols if grid else 1) - MARGIN_IN - BAR_IN * is_coloured
    names = [folded(name, room - LINE_IN, SMALL_SIZE) for name in names]
    widths = [width_of(name, SMALL_SIZE) + LINE_IN for name in names]
    columns = next(n for n in range(len(names), 0, -1) if n == 1 or _width(widths, n) <= room)
    axes.legend(
        handles,
        names,
        ncols=columns,
        loc="lower left",
        bbox_to_anchor=(0.0, 1.0),
        borderaxespad=0.2,
        columnspacing=1.2,
        frameon=False,
        fontsize=SMALL_SIZE,
        title=folded(title, room) or None,
        title_fontsize=LABEL_SIZE,
        alignment="left",
    )


def _width(entries: list[float], columns: int) -> float:
    """Return the inches that a legend takes whose entries are filled in column by column."""
    return float(sum(column.max() for column in np.array_split(entries, columns)))


def looks(count: int) -> Iterable[tuple[str, str, str]]:
    """Return so many looks of lines: style, colour and marker."""
    distinct = cycle((style, *look) for style, look in product(STYLES, zip(COLOURS, MARKERS, strict=True)))
    return [next(distinct) for _ in range(count)]


def draw_references(axes: Axes, known: dict[str, float]) -> None:
    """Draw returns that are known, which the legend names."""
    for (name, value), grey in zip(known.items(), cycle(REFERENCE_GREYS)):
        axes.axhline(value, color=grey, linestyle="--", linewidth=1, label=f"{name}: {value:g}", zorder=1)


def write(path: Path, figure: Figure, **options: Any) -> None:
    """Write a figure, opaque; an existing file is replaced whole or not at all.

    Raises:
        OSError: it cannot be written.
    """
    content = BytesIO()
    figure.savefig(content, **{"dpi": DPI, "facecolor": "white", "transparent": False, **options})
    write_whole(path, content.getvalue(), sync=False)  # what it is drawn from is on the disk
