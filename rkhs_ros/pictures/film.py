"""Render an episode of a policy as a film, and write it to files."""

import os
import sys
import warnings
from collections.abc import Iterator, Sequence
from contextlib import closing, contextmanager
from ctypes.util import find_library
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.font_manager import findfont
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from rkhs_ros.base.validation import require, truncated
from rkhs_ros.pictures.style import write
from rkhs_ros.policies.gaussian import Acting, GaussianPolicy
from rkhs_ros.policies.storage import Task
from rkhs_ros.policies.streams import Batch
from rkhs_ros.rollouts.inline_runner import InlineRunner
from rkhs_ros.rollouts.simulation import Simulation

Pictures = NDArray[np.uint8]  # RGB, shape (height, width, 3), or several of them
FEWEST, MOST, USUAL = 2, 200, 60  # frames of a film
ONE, MANY = "rgb_array", "rgb_array_list"  # render modes: a picture of a state, or pictures of the motion in a step
MOMENTS = 6  # frames of the strip
SECONDS, LAST_MS = 6.0, 1500  # durations of the animation and of its last frame
PALETTE_SIZE = 128
ALMOST_WHITE = 250  # of 255; the choice of colours makes white slightly grey
REMEDY = (
    " (MuJoCo without a display needs EGL or OSMesa: on Debian and Ubuntu, apt install libegl1 libgl1-mesa-dri, "
    "or libosmesa6 and MUJOCO_GL=osmesa)"
)
CAPTION_PART = 18  # height of a frame, relative to that of its caption


@dataclass(frozen=True)
class Film:
    """The frames of an episode."""

    pictures: Pictures  # RGB, shape (frames, height, width, 3)
    captions: list[str]  # the time or step of each frame


def shoot(policy: GaussianPolicy, task: Task, runner: InlineRunner, *, seed: int = 0, frames: int = USUAL) -> Film:
    """Run an episode of a policy without exploration noise, and render frames that are spread evenly over it."""
    require(FEWEST <= frames <= MOST, "frames", f"{FEWEST} to {MOST}", frames)
    batch = Batch(seed, 0, 1, task.horizon, explore=False)
    runner.simulation.start(batch)
    modes = runner.simulation.shown.metadata.get("render_modes") or []
    length = int(runner.collect(policy, batch).mask[0].sum())
    steps = list(range(length + 1)) if MANY in modes else spread(length, frames)
    with closing(_with_pictures(task, modes)) as simulation:
        pictures = [picture for moment in _moments(policy, batch, simulation, steps) for picture in moment]
        rate = simulation.shown.metadata.get("render_fps")
    if MANY not in modes:
        return Film(np.array(pictures), [f"step {step}" for step in steps])
    chosen = spread(len(pictures), frames)
    return Film(np.array(pictures)[chosen], [f"{k / rate:.1f} s" if rate else f"{k}" for k in chosen])


def spread(length: int, count: int) -> list[int]:
    """Return up to `count` indices below `length`, evenly spaced from the first to the last."""
    return [int(k) for k in np.linspace(0, length - 1, min(count, length)).round()]


def _moments(
    policy: GaussianPolicy, batch: Batch, simulation: Simulation, steps: list[int]
) -> Iterator[list[Pictures]]:
    """Yield the pictures that the environment renders before each of the given steps of the episode."""
    acting = Acting(policy, batch, explore=False)
    frame = simulation.start(batch)
    for step in range(steps[-1] + 1):
        if step in steps:
            yield _rendered(simulation)
        if not frame.is_over:
            frame = simulation.step(acting(step, frame.observations))


def _with_pictures(task: Task, modes: list[str]) -> Simulation:
    what = f"an environment with render mode {ONE}"
    require(ONE in modes, task.environment, what, f"one with {', '.join(modes) or 'no render mode'}")
    choose_renderer()
    with _rendering_errors(task.environment):
        return Simulation(task.environment, {**task.options, "render_mode": MANY if MANY in modes else ONE})


def _rendered(simulation: Simulation) -> list[Pictures]:
    with _rendering_errors(simulation.environment), warnings.catch_warnings():
        warnings.simplefilter("ignore")  # about failed backends; the final error is reported in one line
        frame: Any = simulation.shown.render()
    first = frame[0] if isinstance(frame, tuple) else frame  # of a vector environment
    return [np.asarray(picture, dtype=np.uint8) for picture in (first if isinstance(first, list) else [first])]


@contextmanager
def _rendering_errors(environment: str) -> Iterator[None]:
    """Convert any error of an environment's rendering into a ValueError with a hint."""
    try:
        yield
    except Exception as error:
        got = f"{type(error).__name__}: {truncated(error)}{REMEDY * ('mujoco' in sys.modules)}"
        raise ValueError(f"{environment}: expected a rendered frame, got {got}") from error


def choose_renderer() -> None:
    """Let MuJoCo render off-screen if there is no display and the user has not chosen a renderer."""
    has_display = sys.platform != "linux" or any(os.environ.get(name) for name in ("DISPLAY", "WAYLAND_DISPLAY"))
    if not has_display:
        os.environ.setdefault("MUJOCO_GL", "egl" if find_library("EGL") else "osmesa")


def draw_strip(path: Path, film: Film) -> None:
    """Draw selected frames side by side."""
    write(path, strip_figure(film))


def strip_figure(film: Film) -> Figure:
    """Return a figure of selected frames of a film."""
    moments = spread(len(film.captions), MOMENTS)
    height, width = film.pictures.shape[1:3]
    size = (2.0 * len(moments), 2.0 * height / width + 0.3)
    figure = Figure(figsize=size, layout="constrained", facecolor="white")
    row = figure.subplots(1, len(moments), squeeze=False)[0]
    for axes, moment in zip(row, moments, strict=True):
        axes.imshow(film.pictures[moment])
        axes.set(xticks=[], yticks=[], xlabel=film.captions[moment])
    return figure


def animate(path: Path, film: Film) -> None:
    """Write the frames as a GIF."""
    images = [_captioned(picture, caption) for picture, caption in zip(film.pictures, film.captions, strict=True)]
    write_gif(path, images, round(1000.0 * SECONDS / len(images)), LAST_MS)


def write_gif(file: Path | BytesIO, images: Sequence[Image.Image], frame_ms: int, last_ms: int) -> None:
    """Write a GIF with a common palette, which compresses far better than separate ones."""
    palette = Image.fromarray(np.concatenate([np.asarray(images[k]) for k in spread(len(images), MOMENTS)]))
    palette = palette.quantize(PALETTE_SIZE)
    palette.putpalette([255 if value >= ALMOST_WHITE else value for value in palette.getpalette() or []])
    first, *others = [image.quantize(palette=palette, dither=Image.Dither.NONE) for image in images]
    durations = [frame_ms] * len(others) + [last_ms]
    first.save(file, format="GIF", save_all=True, append_images=others, duration=durations, loop=0)


def _captioned(picture: Pictures, caption: str) -> Image.Image:
    image = Image.fromarray(picture)
    size = max(image.height // CAPTION_PART, 6)
    font = ImageFont.truetype(findfont("DejaVu Sans"), size)
    ImageDraw.Draw(image).text((size // 2, size // 3), caption, "black", font, stroke_width=2, stroke_fill="white")
    return image
