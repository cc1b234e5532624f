"""Makes the film of an arm that learns to follow a mark by the wall clock: `python docs/make_arm_film.py RUN`.

RUN is the folder of a run of config/robot_arm.yaml. Its page draws the pictures.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import browser
import numpy as np
from make_screenshots import HERE, SETTLE_S, SHARP, SIZE
from PIL import Image, ImageDraw, ImageFont
from side_by_side_film import write_gif

from rkhs_ros.runs.curve import Curve, Row

ITERATION, MOMENT = 0, 1  # sliders
KEYS = {"Home": 36, "End": 35}
SCENE = (40, 200, 350, 560)  # of the page: left, top, right, bottom
HEADING_PX, LETTERS_PX = 30, 18
DRAWN_S = 0.7  # for the browser to draw a moment


def main() -> None:
    """Write robot_arm.gif beside this file."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("run", type=Path)
    run = parser.parse_args().run
    first, *_, last = Curve(run / "curve.csv").rows()
    with browser.started() as chromium, page_of(run) as address:
        tab = chromium.open(f"{address}?{SHARP}", *SIZE)
        tab.wait_for(f"{browser.each('[role=slider]')}[{MOMENT}]?.ariaValueMax > 1")
        tab.value("document.querySelector('.mantine-Notification-closeButton')?.click()")
        play = f"{browser.each('input[type=checkbox]')}[0]"
        tab.click_on(play)
        tab.wait_for(f"!{play}.checked")
        scenes = [list(_episode(tab, end, row)) for end, row in (("Home", first), ("End", last))]
    pairs = zip(*scenes, strict=True)
    write_gif(HERE / "robot_arm.gif", [Image.fromarray(np.concatenate(pair, axis=1)) for pair in pairs])


@contextmanager
def page_of(run: Path) -> Iterator[str]:
    """Serve the page of a run that has ended; yield its address."""
    command = [sys.executable, "-m", "rkhs_ros.app.cli", "view", str(run), "--port", "0"]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    try:
        yield next(line for line in process.stdout or [] if " at http" in line).split()[-1]
    finally:
        process.terminate()
        process.communicate()


def _episode(tab: browser.Tab, end: str, row: Row) -> Iterator[np.ndarray[Any, Any]]:
    """Yield the pictures of the exploring episode of the first or the last iteration."""
    press(tab, ITERATION, end)
    time.sleep(SETTLE_S)
    most = int(tab.value(f"{browser.each('[role=slider]')}[{MOMENT}].ariaValueMax"))
    x, y, width = tab.value(
        f"(b => [b.x, b.y + b.height / 2, b.width])({browser.each('.mantine-Slider-track')}[{MOMENT}]"
        ".getBoundingClientRect())"
    )
    for moment in range(most + 1):
        tab.click(x + width * moment / most, y)  # arrow keys would move the eye
        time.sleep(DRAWN_S)
        yield _titled(tab.picture(), f"episode {row.episodes}: return {row.train_return:.1f}")


def press(tab: browser.Tab, slider: int, key: str) -> None:
    """Press a key at a slider."""
    tab.value(f"{browser.each('[role=slider]')}[{slider}].focus()")
    for kind in ("keyDown", "keyUp"):
        tab.ask("Input.dispatchKeyEvent", type=kind, key=key, code=key, windowsVirtualKeyCode=KEYS[key])


def _titled(picture: np.ndarray[Any, Any], title: str) -> np.ndarray[Any, Any]:
    left, top, right, bottom = SCENE
    image = Image.new("RGB", (right - left, bottom - top + HEADING_PX), "white")
    image.paste(Image.fromarray(picture[top:bottom, left:right]), (0, HEADING_PX))
    ImageDraw.Draw(image).text((10, 5), title, "black", ImageFont.load_default(LETTERS_PX))
    return np.asarray(image)


if __name__ == "__main__":
    main()
