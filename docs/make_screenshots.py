"""Make the pictures of docs/view.md: the pages of a pendulum, the PR2 and an arm after some iterations."""

import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import browser
import numpy as np
from PIL import Image

HERE = Path(__file__).parent
CONFIGS = HERE.parent / "config"
SIZE = (1280, 800)
SHARP = "fixedDpr=1"  # a full resolution; viser reduces it on slow machines otherwise
LEARNING_TIMEOUT_S = 300.0
SETTLE_S = 3.0  # for the browser to draw a change


class Shot(NamedTuple):
    """The description of a screenshot.

    Attributes:
        config: configuration of the run.
        iteration: number of iterations of the run.
        kind: episode to show, as the page lists it.
        part: position of the time slider, from 0 to 1.
        over_topics: whether the run uses nodes, as for a robot.
    """

    config: str
    iteration: int
    kind: str
    part: float
    over_topics: bool = False


SHOTS = {
    "view_pendulum.png": Shot("pendulum_model_nac", 5, "evaluation 1", 0.1),
    "view_pr2.png": Shot("pr2_door_nac", 11, "evaluation 1", 0.75),
    "view_arm.png": Shot("robot_arm", 8, "exploration 1", 0.45, over_topics=True),
}


def main(names: Sequence[str]) -> None:
    """Write all pictures, or the named ones, beside this file."""
    with browser.started() as chromium:
        for name, shot in SHOTS.items():
            if names and name not in names:
                continue
            with run_of(shot) as address:
                picture = taken(chromium.open(f"{address}?{SHARP}", *SIZE), shot)
            picture.save(HERE / name, optimize=True)
            print(HERE / name)


@contextmanager
def run_of(shot: Shot) -> Iterator[str]:
    """Train a run up to the iteration of a screenshot; yield the address of its page."""
    command = [sys.executable, "-m", "rkhs_ros.app.cli", "train", str(CONFIGS / f"{shot.config}.yaml"), "--quiet"]
    where = ["--runner", "ros" if shot.over_topics else "inline", "--iterations", str(shot.iteration)]
    with tempfile.TemporaryDirectory() as folder:
        subprocess.run([*command, *where, "--out", "run"], cwd=folder, stdout=subprocess.DEVNULL, check=True)
        with page_of(["view", "run"], folder) as address:
            yield address


@contextmanager
def page_of(arguments: Sequence[str], folder: str | Path = ".") -> Iterator[str]:
    """Run an rkhs command that serves a page, in a folder; yield the address of the page."""
    command = [sys.executable, "-m", "rkhs_ros.app.cli", *arguments]
    process = subprocess.Popen(command, cwd=folder, stdout=subprocess.PIPE, text=True)
    try:
        yield next(line for line in process.stdout or [] if " at http" in line).split()[-1]
    finally:
        process.terminate()
        process.communicate()


def taken(tab: browser.Tab, shot: Shot) -> Image.Image:
    """Take the screenshot once the run has reached its iteration."""
    tab.wait_for(reached(shot.iteration), LEARNING_TIMEOUT_S)
    tab.value("document.querySelector('.mantine-Notification-closeButton')?.click()")
    if tab.value("!!document.querySelector('input[value=\"evaluation 1\"]')") and shot.kind != "evaluation 1":
        tab.click_on("document.querySelector('input[value=\"evaluation 1\"]')")
        tab.click_on(f"[...document.querySelectorAll('[role=option]')].find(e => e.innerText === '{shot.kind}')")
    tab.click_on(f"{browser.each('input[type=checkbox]')}[0]")  # play
    slide(tab, shot.part)
    return Image.fromarray(settled(tab))


def reached(iteration: int) -> str:
    """Return an expression that is true once the page shows an iteration or a later one."""
    return f"+((document.body?.innerText.match(/iteration (\\d+) of/) || [0, 0])[1]) >= {iteration}"


def settled(tab: browser.Tab) -> np.ndarray[Any, Any]:
    """Return a picture of the page once it no longer changes."""
    picture, before = tab.picture(), None
    while before is None or not np.array_equal(picture, before):
        time.sleep(SETTLE_S)
        picture, before = tab.picture(), picture
    return picture


def slide(tab: browser.Tab, part: float) -> None:
    """Move the time slider to a part of its range; retry until the page has taken it."""
    thumb = f"{browser.each('[role=slider]')}[1]"
    while not tab.value(f"(s => Math.abs(s.ariaValueNow / s.ariaValueMax - {part}) < 0.05)({thumb})"):
        click_on_time(tab, part)
        time.sleep(SETTLE_S)
    tab.ask("Input.dispatchMouseEvent", type="mouseMoved", x=0, y=0)  # elements under the pointer look different


def click_on_time(tab: browser.Tab, part: float) -> None:
    """Click on the time slider at a part of its range."""
    box = f"{browser.each('.mantine-Slider-track')}[1].getBoundingClientRect()"
    x, y, width = tab.value(f"(b => [b.x, b.y + b.height / 2, b.width])({box})")
    tab.click(x + part * width, y)


if __name__ == "__main__":
    main(sys.argv[1:])
