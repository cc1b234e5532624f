"""A film of episodes that play side by side, beside what they earn."""

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

FRAMES = 50  # pictures of an episode
FRAME_MS, LAST_MS = 60, 3000  # how long a picture stays
WIDTH, HEIGHT, DPI = 9.6, 3.3, 100  # inches
SHADES = 64  # of the film
MOST_BYTES = 2_000_000


class Scene(NamedTuple):
    """An episode that is shown.

    Attributes:
        title: what it is.
        colour: of its line.
        observations: before each step, shape (H, d).
        actions: within their bounds, shape (H, n).
        earned: discounted return of the steps up to each, mean of all episodes of its kind, shape (H,).
    """

    title: str
    colour: str
    observations: Array
    actions: Array
    earned: Array


def scene_of(config: Config, title: str, colour: str, episodes: Episodes, row: int, rewards: Array) -> Scene:
    """Return one of some episodes as it is shown, and what rewards, shape (H,), come to."""
    discounts = config.training.discount ** np.arange(config.training.horizon)
    actions = runner_of(config.environment).spaces.clip(episodes.actions[row])
    return Scene(title, colour, episodes.observations[row], actions, np.cumsum(discounts * rewards))


def frames(config: Config, scenes: list[Scene]) -> Iterator[Image.Image]:
    """Yield the film: the scenes play side by side, and their returns grow beside them."""
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
            line.set_data(np.arange(step + 1), scene.earned[: step + 1])
            if step == steps[-1]:
                earned = scene.earned[step]
                chart.text(step + 2, earned, f"{earned:.1f}", color=scene.colour, va="center", weight="bold")
        canvas.draw()
        yield Image.fromarray(np.array(canvas.buffer_rgba())[:, :, :3])


def _draw(task: Any, axes: Any, scene: Scene, step: int) -> None:
    axes.clear()
    axes.set_axis_off()
    axes.set_title(scene.title, fontsize=12, color=scene.colour)
    task.draw(axes, scene.observations[step], scene.actions[step])


def _chart(config: Config, figure: Figure) -> Any:
    """Return axes for the returns so far, with the best one known."""
    axes = figure.add_axes((0.725, 0.17, 0.215, 0.71))
    name, best = max(references(config.task).items(), key=lambda item: item[1])
    axes.axhline(best, color="0.35", linestyle="--", linewidth=1)
    axes.text(0, best + 1, f"{name.partition(' (')[0]} {best:g}", va="bottom", color="0.35", fontsize=10)
    axes.set(xlim=(0, config.training.horizon), ylim=(0, best * 1.15), xlabel="step", ylabel="return so far")
    axes.spines[["top", "right"]].set_visible(False)
    return axes


def write_gif(path: Path, images: list[Image.Image]) -> None:
    """Write a film, of few shades.

    Raises:
        ValueError: it takes too many bytes.
    """
    palette = images[-1].quantize(SHADES, method=Image.Quantize.MAXCOVERAGE)  # keeps white as it is
    first, *others = [image.quantize(palette=palette, dither=Image.Dither.NONE) for image in images]
    buffer = BytesIO()
    durations = [FRAME_MS] * len(others) + [LAST_MS]
    first.save(buffer, format="GIF", save_all=True, append_images=others, duration=durations, loop=0)
    if len(buffer.getvalue()) > MOST_BYTES:
        raise ValueError(f"{path}: expected at most {MOST_BYTES} bytes, got {len(buffer.getvalue())}")
    path.write_bytes(buffer.getvalue())
