"""Write a film to files: a strip of selected frames, and an animation of all frames."""

from io import BytesIO
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from matplotlib.font_manager import findfont
from PIL import Image, ImageDraw, ImageFont

from rkhs_ros.pictures.film import Film, Pictures, spread
from rkhs_ros.pictures.style import write

MOMENTS = 6  # frames of the strip
SECONDS, LAST_MS = 6.0, 1500  # durations of the animation and of its last frame
LIMIT = 3_000_000  # bytes of the animation
SMALLER = 0.8  # factor of the width while the animation exceeds the limit
COLOURS = 128
STILL = 1e-3  # fraction of pixels that may differ between frames without motion
CAPTION_PART = 18  # height of a frame, relative to that of its caption


def draw_strip(path: Path, film: Film) -> None:
    """Draw selected frames side by side, from the first motion on."""
    write(path, strip_figure(film))


def strip_figure(film: Film) -> Figure:
    """Return a figure of selected frames of a film."""
    first = first_motion(film)
    moments = [first + moment for moment in spread(len(film.captions) - first, MOMENTS)]
    height, width = film.pictures.shape[1:3]
    size = (2.0 * len(moments), 2.0 * height / width + 0.3)
    figure = Figure(figsize=size, layout="constrained", facecolor="white")
    row = figure.subplots(1, len(moments), squeeze=False)[0]
    for axes, moment in zip(row, moments, strict=True):
        axes.imshow(film.pictures[moment])
        axes.set(xticks=[], yticks=[], frame_on=False, xlabel=film.captions[moment])
    return figure


def animate(path: Path, film: Film) -> None:
    """Write the frames from the first motion on as a GIF.

    The frames are scaled down if the file would be too large.
    """
    first = first_motion(film)
    moments = zip(film.pictures[first:], film.captions[first:], strict=True)
    images = [_captioned(picture, caption) for picture, caption in moments]
    while len(data := _gif(images)) > LIMIT:
        size = [max(round(SMALLER * length), 1) for length in images[0].size]
        images = [image.resize((size[0], size[1]), Image.Resampling.LANCZOS) for image in images]
    path.write_bytes(data)


def first_motion(film: Film) -> int:
    """Return the index of the last frame before the first motion; 0 if nothing moves."""
    moved = (film.pictures != film.pictures[0]).any(axis=3).mean(axis=(1, 2)) > STILL
    return max(int(moved.argmax()) - 1, 0)


def _captioned(picture: Pictures, caption: str) -> Image.Image:
    image = Image.fromarray(picture)
    size = max(image.height // CAPTION_PART, 6)
    font = ImageFont.truetype(findfont("DejaVu Sans"), size)
    ImageDraw.Draw(image).text((size // 2, size // 3), caption, "black", font, stroke_width=2, stroke_fill="white")
    return image


def _gif(images: list[Image.Image]) -> bytes:
    """Encode the images as a GIF with a common palette, which compresses far better than separate ones."""
    some = np.concatenate([np.asarray(images[moment]) for moment in spread(len(images), MOMENTS)])
    palette = Image.fromarray(some).quantize(COLOURS)
    first, *others = [image.quantize(palette=palette, dither=Image.Dither.NONE) for image in images]
    buffer = BytesIO()
    durations = [round(1000.0 * SECONDS / len(images))] * len(others) + [LAST_MS]
    first.save(buffer, format="GIF", save_all=True, append_images=others, duration=durations, loop=0)
    return buffer.getvalue()
