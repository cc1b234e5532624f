"""Make a film of episodes that play side by side, with a plot of their returns."""

from __future__ import annotations

from collections.abc import Iterator
from io import BytesIO
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from PIL import Image

from rkhs_ros.app.inline import runner_of
from rkhs_ros.learning.episodes import Episodes
from rkhs_ros.pictures.film import spread
from rkhs_ros.pictures.known import references
from rkhs_ros.rkhs.kernels import Array
from rkhs_ros.runs.config import Config

FRAMES = 50  # per episode
FRAME_MS, LAST_MS = 60, 3000  # durations of a frame and of the last one
WIDTH, HEIGHT, DPI = 9.6, 3.3, 100  # inches
SHADES = 64  # colours in the film
MAX_BYTES = 2_000_000


class Scene(NamedTuple):
    """An episode in the film.

    Attributes:
        title: title of its panel.
        colour: colour of its line in the plot.
        observations: before each step, shape (H, d).
        actions: clipped to their bounds, shape (H, n).
        returns: discounted return up to each step, mean of all episodes of its kind, shape (H,).
    """

    title: str
    colour: str
    observations: Array
    actions: Array
    returns: Array


def scene_of(config: Config, title: str, colour: str, episodes: Episodes, index: int, rewards: Array) -> Scene:
    """Return the scene of one of several episodes, with the returns that follow from rewards of shape (H,)."""
    discounts = config.training.discount ** np.arange(config.training.horizon)
    actions = runner_of(config.environment).spaces.clip(episodes.actions[index])
    return Scene(title, colour, episodes.observations[index], actions, np.cumsum(discounts * rewards))


def frames(config: Config, scenes: list[Scene]) -> Iterator[Image.Image]:
    """Yield the frames: the scenes side by side, and the plot of their returns so far."""
    figure = Figure(figsize=(WIDTH, HEIGHT), dpi=DPI, facecolor="white")
    canvas: Any = FigureCanvasAgg(figure)
    task: Any = runner_of(config.environment).simulation.shown
    chart = _chart(config, figure)
    lines = [chart.plot([], [], color=scene.colour, linewidth=2.5)[0] for scene in scenes]
    panels = [figure.add_axes((0.33 * k, 0.0, 0.33, 0.88)) for k in range(len(scenes))]
    steps = spread(config.training.horizon, FRAMES)
    for step in steps:
        for axes, line, scene in zip(panels, lines, scenes, strict=True):
            _draw(task, axes, scene, step)
            line.set_data(np.arange(step + 1), scene.returns[: step + 1])
            if step == steps[-1]:
                value = scene.returns[step]
                chart.text(step + 2, value, f"{value:.1f}", color=scene.colour, va="center", weight="bold")
        canvas.draw()
        yield Image.fromarray(np.array(canvas.buffer_rgba())[:, :, :3])


def _draw(task: Any, axes: Any, scene: Scene, step: int) -> None:
    axes.clear()
    axes.set_axis_off()
    axes.set_title(scene.title, fontsize=12, color=scene.colour)
    task.draw(axes, scene.observations[step], scene.actions[step])


def _chart(config: Config, figure: Figure) -> Any:
    """Return axes for the returns so far, with a line at the best known return."""
    axes = figure.add_axes((0.725, 0.17, 0.215, 0.71))
    name, best = max(references(config.task).items(), key=lambda item: item[1])
    axes.axhline(best, color="0.35", linestyle="--", linewidth=1)
    axes.text(0, best + 1, f"{name.partition(' (')[0]} {best:g}", va="bottom", color="0.35", fontsize=10)
    axes.set(xlim=(0, config.training.horizon), ylim=(0, best * 1.15), xlabel="step", ylabel="return so far")
    axes.spines[["top", "right"]].set_visible(False)
    return axes


def write_gif(path: Path, images: list[Image.Image]) -> None:
    """Write a film as a GIF with few colours.

    Raises:
        ValueError: the file would be larger than `MAX_BYTES`.
    """
    palette = images[-1].quantize(SHADES, method=Image.Quantize.MAXCOVERAGE)  # keeps white as it is
    first, *others = [image.quantize(palette=palette, dither=Image.Dither.NONE) for image in images]
    buffer = BytesIO()
    durations = [FRAME_MS] * len(others) + [LAST_MS]
    first.save(buffer, format="GIF", save_all=True, append_images=others, duration=durations, loop=0)
    if len(buffer.getvalue()) > MAX_BYTES:
        raise ValueError(f"{path}: expected at most {MAX_BYTES} bytes, got {len(buffer.getvalue())}")
    path.write_bytes(buffer.getvalue())
