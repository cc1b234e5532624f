"""Make a film of episodes that play side by side, with a plot of a number of each."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from io import BytesIO
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.patheffects import withStroke
from numpy.typing import NDArray
from PIL import Image

from rkhs_ros.pictures.film import spread
from rkhs_ros.pictures.style import LABEL_SIZE, width_of
from rkhs_ros.rkhs.kernels import Array

FRAMES = 50  # per episode
FRAME_MS, LAST_MS = 60, 3000  # durations of a frame and of the last one
WIDTH, HEIGHT, DPI = 9.6, 3.3, 100  # inches
PANEL, TOP = 0.33, 0.88  # width and height of a panel, relative to the figure
PICTURE_SIZE = (round(PANEL * WIDTH * DPI), round(TOP * HEIGHT * DPI))  # pixels
SHADES = 128  # colours in the film
ALMOST_WHITE = 250  # of 255; the choice of colours makes white slightly grey
SAMPLES = 6  # frames from which to choose the colours
MAX_BYTES = 2_000_000
HALO = [withStroke(linewidth=3, foreground="white")]


class Label(NamedTuple):
    """The name of an object in a picture.

    Attributes:
        text: name of the object.
        colour: colour of the text.
        place: column and row of the object in the picture.
        offset: from the object to the centre of the text, in pixels to the right and down.
    """

    text: str
    colour: str
    place: tuple[float, float]
    offset: tuple[float, float]


class Moment(NamedTuple):
    """What a panel shows at a step.

    Attributes:
        picture: RGB, of `PICTURE_SIZE`.
        labels: of the objects in it.
        note: text at its lower edge, such as a number of the task.
    """

    picture: NDArray[np.uint8]
    labels: tuple[Label, ...]
    note: str


class Scene(NamedTuple):
    """An episode in the film.

    Attributes:
        title: title of its panel.
        colour: colour of its line in the plot.
        moment: function that draws a step.
        values: number to plot at each step, shape (H,).
    """

    title: str
    colour: str
    moment: Callable[[int], Moment]
    values: Array


class Chart(NamedTuple):
    """The plot beside the panels.

    Attributes:
        x: label of the x axis.
        y: label of the y axis.
        step: length of a step on the x axis.
        top: upper end of the y axis.
        reference: value at which to draw a dashed line.
        reference_name: label of that line.
        unit: written after the numbers at the ends of the lines.
    """

    x: str
    y: str
    step: float
    top: float
    reference: float
    reference_name: str
    unit: str = ""


def frames(scenes: list[Scene], chart: Chart) -> Iterator[Image.Image]:
    """Yield the frames: the scenes side by side, and the plot of their numbers so far."""
    figure = Figure(figsize=(WIDTH, HEIGHT), dpi=DPI, facecolor="white")
    canvas: Any = FigureCanvasAgg(figure)
    length = len(scenes[0].values)
    axes = _chart_axes(figure, chart, length)
    lines = [axes.plot([], [], color=scene.colour, linewidth=2.5)[0] for scene in scenes]
    ends = [axes.text(0, 0, "", color=scene.colour, va="center", weight="bold") for scene in scenes]
    panels = [figure.add_axes((PANEL * k, 0.0, PANEL, TOP)) for k in range(len(scenes))]
    times = chart.step * np.arange(length)
    for step in spread(length, FRAMES):
        for panel, line, end, scene in zip(panels, lines, ends, scenes, strict=True):
            _draw(panel, scene, step)
            line.set_data(times[: step + 1], scene.values[: step + 1])
            end.set_text(f"{scene.values[step]:.1f}{chart.unit}")
            end.set_position((times[step] + 0.02 * times[-1], scene.values[step]))
        canvas.draw()
        yield Image.fromarray(np.array(canvas.buffer_rgba())[:, :, :3])


def _draw(panel: Any, scene: Scene, step: int) -> None:
    """Draw a step of an episode, with labels."""
    moment = scene.moment(step)
    panel.clear()
    panel.set_axis_off()
    panel.set_title(scene.title, fontsize=12, color=scene.colour)
    panel.imshow(moment.picture, interpolation="nearest")
    for label in moment.labels:
        (x, y), (right, down) = label.place, label.offset
        line = {"arrowstyle": "-", "color": label.colour, "linewidth": 0.8, "shrinkA": 0, "shrinkB": 0}
        half = DPI * width_of(label.text, LABEL_SIZE) / 2
        place = min(max(x + right, half), PICTURE_SIZE[0] - half), y + down  # within the panel
        look = {"ha": "center", "va": "center", "fontsize": LABEL_SIZE, "color": label.colour, "path_effects": HALO}
        panel.annotate(label.text, (x, y), place, arrowprops=line, **look)
    panel.text(0.5, 0.03, moment.note, transform=panel.transAxes, ha="center", fontsize=12, path_effects=HALO)


def _chart_axes(figure: Figure, chart: Chart, length: int) -> Any:
    """Return axes for the numbers so far, with a dashed line at the reference."""
    axes = figure.add_axes((0.735, 0.17, 0.19, 0.71))
    end = chart.step * length
    axes.axhline(chart.reference, color="0.35", linestyle="--", linewidth=1)
    name = {"va": "bottom", "color": "0.35", "fontsize": 10, "path_effects": HALO}
    axes.text(0.04 * end, chart.reference + 0.015 * chart.top, chart.reference_name, **name)
    axes.set(xlim=(0, end), ylim=(0, chart.top), xlabel=chart.x, ylabel=chart.y)
    axes.spines[["top", "right"]].set_visible(False)
    return axes


def write_gif(path: Path, images: list[Image.Image], frame_ms: int = FRAME_MS) -> None:
    """Write a film as a GIF with few colours.

    Raises:
        ValueError: the file would be larger than `MAX_BYTES`.
    """
    some = np.concatenate([np.asarray(images[k]) for k in spread(len(images), SAMPLES)])
    palette = Image.fromarray(some).quantize(SHADES)
    palette.putpalette([255 if value >= ALMOST_WHITE else value for value in palette.getpalette() or []])
    first, *others = [image.quantize(palette=palette, dither=Image.Dither.NONE) for image in images]
    buffer = BytesIO()
    durations = [frame_ms] * len(others) + [LAST_MS]
    first.save(buffer, format="GIF", save_all=True, append_images=others, duration=durations, loop=0)
    if len(buffer.getvalue()) > MAX_BYTES:
        raise ValueError(f"{path}: expected at most {MAX_BYTES} bytes, got {len(buffer.getvalue())}")
    path.write_bytes(buffer.getvalue())
