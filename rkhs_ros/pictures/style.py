"""Define the style of all pictures: colours for colour-blind readers, text that fits, legends outside the data."""

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
from matplotlib.layout_engine import ConstrainedLayoutEngine
from matplotlib.ticker import MaxNLocator, ScalarFormatter
from numpy.typing import NDArray

from rkhs_ros.base.files import write_whole

# The colours of Okabe and Ito, which colour-blind readers can distinguish; yellow is last because it is faint on white.
COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#56B4E9", "#E69F00", "#000000", "#F0E442")
MARKERS = ("o", "s", "^", "D", "v", "P", "X", "*")  # distinguish curves in black and white
STYLES = ("-", "-.", ":")  # one for every eight curves; reference returns use "--"
SIGNED, UNSIGNED = "coolwarm", "viridis"  # perceptually uniform, also for colour-blind readers
REFERENCE_GREYS = ("0.2", "0.45", "0.65")  # of reference returns
DPI = 120
POINTS = 72  # per inch
LETTER = 0.60  # width of a letter, relative to the size of the font
TITLE_SIZE, LABEL_SIZE, SMALL_SIZE = 11, 10, 9  # points
MARGIN_IN = 0.8  # greatest margin beside a plot, without a colour bar
BAR_IN = 0.9  # width of a colour bar with its numbers and name
LINE_IN = 0.55  # inches of the line before a legend's entry
TICKS_PER_INCH, FEWEST_TICKS, MOST_TICKS = (1.3, 1.8), 2, 8  # along the x and the y axis
TICK_STEPS = (1, 2, 2.5, 5, 10)


def _plain() -> ScalarFormatter:
    formatter = ScalarFormatter(useOffset=False)
    formatter.set_scientific(False)
    return formatter


def sheet(width: float, height: float, title: str = "") -> Figure:
    """Return a white figure of a size in inches, with a title that is wrapped to fit."""
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
    """Label the axes of a plot and set its title, wrapped to fit."""
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
        axis.set_major_formatter(_plain())


def whole_ticks(axes: Axes) -> None:
    """Place the ticks of the x axis at whole numbers."""
    locator: Any = axes.xaxis.get_major_locator()
    locator.set_params(integer=True, min_n_ticks=1)


def colour_bar(axes: Axes, image: ScalarMappable, name: str) -> None:
    """Add a colour bar beside a plot."""
    bar = axes.figure.colorbar(image, ax=axes, format=_plain())
    bar.set_label(folded(name, _size(axes)[1]), fontsize=LABEL_SIZE)


def _size(axes: Axes) -> tuple[float, float]:
    """Return the approximate width and height of a plot in inches, before its texts are laid out."""
    figure: Any = axes.figure
    place = axes.get_subplotspec()
    width, height = figure.get_size_inches()
    part = axes.get_position() if place is None else place.get_position(figure)
    return width * part.width, height * part.height


def folded(text: str, inches: float, size: float = LABEL_SIZE) -> str:
    """Wrap a text to a width in inches at a font size in points."""
    return "\n".join(wrap(text, max(int(inches / _letter(size)), 8)))


def _letter(size: float) -> float:
    """Return the width in inches of a letter at a font size in points, a little more than the average."""
    return LETTER * size / POINTS


def legend_above(axes: Axes, title: str = "") -> None:
    """Add a legend above a plot, where it covers no data, with an optional title."""
    handles, names = axes.get_legend_handles_labels()
    figure, grid = axes.figure, axes.get_gridspec()
    is_coloured = any(each.colorbar is not None for each in (*axes.collections, *axes.images))
    available = figure.bbox.width / figure.dpi / (grid.ncols if grid else 1) - MARGIN_IN - BAR_IN * is_coloured
    names = [folded(name, available - LINE_IN, SMALL_SIZE) for name in names]
    widths = [max(map(len, name.splitlines())) * _letter(SMALL_SIZE) + LINE_IN for name in names]
    fitting = (n for n in range(len(names), 1, -1) if sum(map(max, np.array_split(widths, n))) <= available)
    columns = next(fitting, 1)
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
        title=folded(title, available) or None,
        title_fontsize=LABEL_SIZE,
        alignment="left",
    )


def looks(count: int) -> Iterable[tuple[str, str, str]]:
    """Return distinct line looks: style, colour and marker."""
    distinct = cycle((style, *look) for style, look in product(STYLES, zip(COLOURS, MARKERS, strict=True)))
    return [next(distinct) for _ in range(count)]


def draw_references(axes: Axes, known: dict[str, float]) -> None:
    """Draw reference returns as dashed lines with legend entries."""
    for (name, value), grey in zip(known.items(), cycle(REFERENCE_GREYS)):
        axes.axhline(value, color=grey, linestyle="--", linewidth=1, label=f"{name}: {value:g}", zorder=1)


def write(path: Path, figure: Figure, **options: Any) -> None:
    """Write a figure with an opaque background; replace an existing file atomically."""
    content = BytesIO()
    figure.savefig(content, **{"dpi": DPI, "facecolor": "white", "transparent": False, **options})
    write_whole(path, content.getvalue(), sync=False)  # can be drawn again from the run's files
