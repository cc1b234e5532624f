"""Makes the pictures of the README and of docs/start.md: the pendulum as it learns, its curve and its policy."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from io import BytesIO
from itertools import islice
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from PIL import Image

from rkhs_ros.app.inline import iterations, runner_of
from rkhs_ros.learning.training import Iteration
from rkhs_ros.pictures.film import Pictures, shoot
from rkhs_ros.pictures.run_pictures import draw_run, references
from rkhs_ros.runs.config import Config, load_config
from rkhs_ros.runs.run import run_training

HERE = Path(__file__).parent
CONFIG = HERE.parent / "config" / "pendulum_nac.yaml"
SHOWN = (1, 2, 5, 20)  # iterations of which an episode is seen, one after another
FRAMES = 34  # pictures of an episode
FRAME_MS, LAST_MS = 60, 3000  # how long a picture stays
WIDTH, HEIGHT, DPI = 8.4, 4.6, 100  # inches
COLOURS = 64
MOST_BYTES = 2_000_000


class Scene(NamedTuple):
    """An episode after some iterations, frame by frame."""

    iteration: Iteration
    pictures: Pictures


def main() -> None:
    """Write pendulum_learns.gif, pendulum_curve.png and pendulum_policy.png beside this file."""
    config = load_config(CONFIG)
    learnt = list(islice(iterations(config), SHOWN[-1]))
    scenes = [Scene(learnt[number - 1], _episode(config, learnt[number - 1])) for number in SHOWN]
    _write_gif(HERE / "pendulum_learns.gif", list(_frames(config, learnt, scenes)))
    with tempfile.TemporaryDirectory() as folder:
        run_training(config, runner_of(config.environment), Path(folder), quiet=True)
        for picture in draw_run(Path(folder)):
            (HERE / f"pendulum_{picture.name}").write_bytes(picture.read_bytes())


def _episode(config: Config, iteration: Iteration) -> Pictures:
    return shoot(iteration.policy, config.task, runner_of(config.environment), frames=FRAMES).pictures[""]


def _frames(config: Config, learnt: list[Iteration], scenes: list[Scene]) -> Iterator[Image.Image]:
    """Yield the film: the scenes play from left to right, and the curve grows up to the one that plays."""
    figure = Figure(figsize=(WIDTH, HEIGHT), dpi=DPI)
    canvas: Any = FigureCanvasAgg(figure)
    panels = [figure.add_axes((k / len(scenes), 0.52, 1 / len(scenes), 0.40)) for k in range(len(scenes))]
    line, dots = _curve_axes(config, learnt, figure)
    for axes in panels:
        axes.set_axis_off()
    for k, (axes, scene) in enumerate(zip(panels, scenes, strict=True)):
        axes.set_title(f"after {scene.iteration.episodes_used} episodes", fontsize=12)
        image = axes.imshow(scene.pictures[0])
        until = learnt[: scene.iteration.number]
        line.set_data([i.episodes_used for i in until], [i.mean_policy_returns.mean() for i in until])
        chosen = [s.iteration for s in scenes[: k + 1]]
        dots.set_data([i.episodes_used for i in chosen], [i.mean_policy_returns.mean() for i in chosen])
        for picture in scene.pictures:
            image.set_data(picture)
            canvas.draw()
            yield Image.fromarray(np.array(canvas.buffer_rgba())[:, :, :3])


def _curve_axes(config: Config, learnt: list[Iteration], figure: Figure) -> tuple[Any, Any]:
    """Return the line and the dots of the learning curve, empty, in axes of their own."""
    axes = figure.add_axes((0.08, 0.13, 0.89, 0.36))
    (line,) = axes.plot([], [], color="tab:blue", linewidth=2)
    (dots,) = axes.plot([], [], "o", color="tab:orange", markersize=8)
    name, best = max(references(config.task).items(), key=lambda item: item[1])
    axes.axhline(best, color="grey", linestyle="--", linewidth=1)
    axes.text(learnt[-1].episodes_used, best + 1, name, ha="right", va="bottom", color="grey", fontsize=10)
    axes.set(
        xlim=(0, learnt[-1].episodes_used * 1.01), ylim=(0, best * 1.2), xlabel="episodes", ylabel="return, noise-free"
    )
    return line, dots


def _write_gif(path: Path, images: list[Image.Image]) -> None:
    palette = images[-1].quantize(COLOURS, method=Image.Quantize.MAXCOVERAGE)  # keeps white as it is
    first, *others = [image.quantize(palette=palette, dither=Image.Dither.NONE) for image in images]
    buffer = BytesIO()
    durations = [FRAME_MS] * len(others) + [LAST_MS]
    first.save(buffer, format="GIF", save_all=True, append_images=others, duration=durations, loop=0)
    if len(buffer.getvalue()) > MOST_BYTES:
        raise ValueError(f"{path}: expected at most {MOST_BYTES} bytes, got {len(buffer.getvalue())}")
    path.write_bytes(buffer.getvalue())


if __name__ == "__main__":
    main()
