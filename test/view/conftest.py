"""The page of a run in a headless browser, Debian's Chromium; skipped if it is not installed."""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

browser = pytest.importorskip("browser")  # from docs/, which uses it for screenshots
PATIENCE_S = 60.0  # far longer than any operation here
TASK = 0.25  # right end of the task, relative to the window's width
PANEL = 0.61  # left end of the panel, relative to a window's width of 1000 pixels


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    for item in items:
        if Path(__file__).parent in item.path.parents:
            item.add_marker(pytest.mark.browser)
            item.add_marker(pytest.mark.xdist_group("chromium"))


@pytest.fixture(scope="session")
def chromium() -> Iterator[browser.Browser]:
    """A browser."""
    if browser.found() is None:
        pytest.skip("Chromium is not installed")
    pytest.importorskip("viser")
    with browser.started() as each:
        yield each


class Viewing:
    """A process that serves a page: ``rkhs view``, or ``rkhs train --view``."""

    def __init__(self, *arguments: object) -> None:
        self.popen = subprocess.Popen(
            [sys.executable, "-m", "rkhs_ros.app.cli", *map(str, arguments)],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            env={k: v for k, v in os.environ.items() if k != "_ROS_WHEELS_BOOTSTRAP_COMPLETE"},
        )
        lines = iter(self.popen.stdout.readline, "")
        self.address = next((line.split()[-1] for line in lines if " at http://" in line), "")
        if not self.address:
            raise RuntimeError(self.popen.stderr.read())

    def interrupt(self) -> None:
        self.popen.send_signal(signal.SIGINT)

    def finish(self) -> tuple[int, str]:
        """Wait for the end; return exit code and standard error."""
        _, err = self.popen.communicate(timeout=PATIENCE_S)
        return self.popen.returncode, err


@pytest.fixture
def serve() -> Iterator[Callable[..., Viewing]]:
    """Start processes; those that remain are killed after the test."""
    started: list[Viewing] = []

    def begin(*arguments: object) -> Viewing:
        started.append(Viewing(*arguments))
        return started[-1]

    yield begin
    for each in started:
        each.popen.kill()
        each.popen.communicate()


def shown(tab: browser.Tab, what: Callable[[np.ndarray], bool], timeout_s: float = PATIENCE_S) -> np.ndarray:
    """Return a picture of the page once it meets a condition."""
    deadline = time.monotonic() + timeout_s
    while True:
        picture = tab.picture()
        if what(picture):
            return picture
        assert time.monotonic() < deadline, tab.text()
        time.sleep(0.2)


def near(picture: np.ndarray, colour: tuple[int, int, int], tolerance: int = 12) -> int:
    return int((np.abs(picture.astype(int) - colour).max(axis=2) <= tolerance).sum())


def scene(picture: np.ndarray) -> np.ndarray:
    return picture[150:, : int(TASK * picture.shape[1])]


def policy(picture: np.ndarray) -> np.ndarray:
    return picture[150:, int(TASK * picture.shape[1]) : int(PANEL * picture.shape[1])]


def panel(picture: np.ndarray) -> np.ndarray:
    return picture[:, int(PANEL * picture.shape[1]) :]
