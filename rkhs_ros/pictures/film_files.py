"""The files of a film: some of its moments side by side, and all of it as an animation."""

from __future__ import annotations

from io import BytesIO
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from PIL import Image, ImageDraw

from rkhs_ros.pictures.film import Film, Pictures, spread

MOMENTS = 8  # of the strip
SECONDS = 6.0  # that the animation lasts
LIMIT = 2_000_000  # bytes of the animation
COLOURS = 128


def draw_strip(path: Path, film: Film) -> None:
    """Draw some moments side by side, a row for each camera."""
    moments = spread(len(film.captions), MOMENTS)
    height, width = next(iter(film.pictures.values())).shape[1:3]
    size = (2.0 * len(moments), 2.0 * height / width * len(film.pictures) + 0.3)
    figure = Figure(figsize=size, layout="constrained")
    rows = figure.subplots(len(film.pictures), len(moments), squeeze=False)
    for row, (camera, pictures) in zip(rows, film.pictures.items(), strict=True):
        row[0].set_ylabel(camera)
        for axes, moment in zip(row, moments, strict=True):
            axes.imshow(pictures[moment])
            axes.set(xticks=[], yticks=[], frame_on=False)
    for axes, moment in zip(rows[-1], moments, strict=True):
        axes.set_xlabel(film.captions[moment])
    figure.savefig(path, dpi=120)


def animate(path: Path, film: Film) -> None:
    """Write all pictures as a GIF, the cameras beside one another; smaller ones where it would be a large file."""
    wide = np.concatenate(list(film.pictures.values()), axis=2)
    images = [_captioned(picture, caption) for picture, caption in zip(wide, film.captions, strict=True)]
    while len(data := _gif(images)) > LIMIT:
        images = [image.reduce(2) for image in images]
    path.write_bytes(data)


def _captioned(picture: Pictures, caption: str) -> Image.Image:
    image = Image.fromarray(picture)
    ImageDraw.Draw(image).text((6, 4), caption, fill="black", stroke_width=2, stroke_fill="white")
    return image


def _gif(images: list[Image.Image]) -> bytes:
    """Return the images in common colours, which compress far better than colours of their own."""
    some = np.concatenate([np.asarray(images[moment]) for moment in spread(len(images), MOMENTS)])
    palette = Image.fromarray(some).quantize(COLOURS)
    first, *others = [image.quantize(palette=palette, dither=Image.Dither.NONE) for image in images]
    buffer = BytesIO()
    duration = round(1000.0 * SECONDS / len(images))
    first.save(buffer, format="GIF", save_all=True, append_images=others, duration=duration, loop=0)
    return buffer.getvalue()
