"""Make the film of an arm that learns to follow a mark: `python docs/make_arm_film.py RUN`.

RUN is the folder of a run of config/robot_arm.yaml. The frames are screenshots of its page.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import browser
import numpy as np
from make_screenshots import HERE, SETTLE_S, SHARP, SIZE, click_on_time, page_of
from PIL import Image, ImageDraw, ImageFont
from side_by_side_film import write_gif

from rkhs_ros.runs.curve import Curve, Row

ITERATION, MOMENT = 0, 1  # sliders
SCENE = (40, 200, 350, 560)  # of the page: left, top, right, bottom
HEADING_PX, LETTERS_PX = 30, 18
DRAWN_S = 0.7  # time for the browser to draw a frame


def main() -> None:
    """Write robot_arm.gif beside this file."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("run", type=Path)
    run = parser.parse_args().run
    first, *_, last = Curve(run / "curve.csv").rows()
    with browser.started() as chromium, page_of(["view", str(run), "--port", "0"]) as address:
        tab = chromium.open(f"{address}?{SHARP}", *SIZE)
        tab.wait_for(f"{browser.each('[role=slider]')}[{MOMENT}]?.ariaValueMax > 1")
        tab.value("document.querySelector('.mantine-Notification-closeButton')?.click()")
        play = f"{browser.each('input[type=checkbox]')}[0]"
        tab.click_on(play)
        tab.wait_for(f"!{play}.checked")
        scenes = [list(_episode(tab, end, row)) for end, row in (("Home", first), ("End", last))]
    pairs = zip(*scenes, strict=True)
    write_gif(HERE / "robot_arm.gif", [Image.fromarray(np.concatenate(pair, axis=1)) for pair in pairs])


def _episode(tab: browser.Tab, end: str, row: Row) -> Iterator[np.ndarray[Any, Any]]:
    """Yield the frames of the exploration episode of the first or the last iteration."""
    tab.press(f"{browser.each('[role=slider]')}[{ITERATION}]", end)
    time.sleep(SETTLE_S)
    most = int(tab.value(f"{browser.each('[role=slider]')}[{MOMENT}].ariaValueMax"))
    for moment in range(most + 1):
        click_on_time(tab, moment / most)  # arrow keys would move the camera
        time.sleep(DRAWN_S)
        yield _titled(tab.picture(), f"episode {row.episodes}: return {row.exploration_return:.1f}")


def _titled(picture: np.ndarray[Any, Any], title: str) -> np.ndarray[Any, Any]:
    left, top, right, bottom = SCENE
    image = Image.new("RGB", (right - left, bottom - top + HEADING_PX), "white")
    image.paste(Image.fromarray(picture[top:bottom, left:right]), (0, HEADING_PX))
    ImageDraw.Draw(image).text((10, 5), title, "black", ImageFont.load_default(LETTERS_PX))
    return np.asarray(image)


if __name__ == "__main__":
    main()
