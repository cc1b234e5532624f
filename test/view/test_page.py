"""The page of a run: over topics during the run, from its folder afterwards, and from its recording alone."""

import shutil
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from browser import Browser, Tab, each

from rkhs_ros.runs.config import load_config
from rkhs_ros.runs.curve import Curve
from rkhs_ros.runs.run import run_training
from test.view.conftest import PATIENCE_S, Viewing, near, panel, policy, scene, shown

CONFIGS = Path(__file__).parents[2] / "config"
EVALUATION, RED, BLUE = (0, 114, 178), (180, 4, 38), (59, 76, 192)
FLOOR = 100  # brightness below that of the floor's lines, which may leave the window
ORANGE = ((180, 60, 0), (255, 190, 110))  # range of the colours of the torque's arc, in light and shade
PANEL_BOX = "document.querySelector('.mantine-Paper-root').getBoundingClientRect()"
Serve = Callable[..., Viewing]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A finished run with a recording."""
    from rkhs_ros.app.inline import runner_of

    config = load_config(CONFIGS / "pendulum_few_nac.yaml", ["iterations=3"])
    path = tmp_path_factory.mktemp("page") / "run"
    return run_training(config, runner_of(config.environment), path, quiet=True)


def has_free_edges(picture: np.ndarray) -> bool:
    """Return whether only what is grey, as the floor is, leaves a part of the page at its left, right or bottom."""
    edges = [edge.reshape(-1, 3).astype(int) for edge in (picture[:, :6], picture[:, -6:], picture[-6:])]
    return all(bool((edge > FLOOR).all() and (np.ptp(edge, axis=1) < 30).all()) for edge in edges)


def shows_policy(picture: np.ndarray) -> bool:
    return near(policy(picture), RED, 60) + near(policy(picture), BLUE, 60) > 8_000


def shows_pendulum(picture: np.ndarray) -> bool:
    low, high = ORANGE
    return int(((scene(picture) >= low) & (scene(picture) <= high)).all(axis=2).sum()) > 100


def shows_curve(picture: np.ndarray) -> bool:
    return near(panel(picture), EVALUATION, 30) > 150


def shows_all(picture: np.ndarray) -> bool:
    return shows_policy(picture) and shows_pendulum(picture) and shows_curve(picture)


def press(tab: Tab, label: str) -> None:
    tab.click_on(f"[...document.querySelectorAll('button')].find(b => b.innerText.trim() === {label!r})")


def stop_playing(tab: Tab) -> None:
    play = f"{each('input[type=checkbox]')}[0]"
    tab.click_on(play)
    tab.wait_for(f"!{play}.checked")


def slide(tab: Tab, number: int, key: str) -> None:
    """Move a slider to one of its ends: Home or End."""
    tab.press(f"{each('[role=slider]')}[{number}]", key)


def lines(folder: Path) -> int:
    return len(Curve(folder / "curve.csv").rows())


@pytest.mark.ros
def test_the_page_follows_a_run_until_it_ends(chromium: Browser, serve: Serve, tmp_path: Path) -> None:
    out = tmp_path / "run"
    # more iterations than the test waits for
    train = serve("train", CONFIGS / "pendulum_few_nac.yaml", "--iterations", 2000, "--out", out, "--view", "--quiet")
    tab = chromium.open(train.address)
    tab.wait_for_text("Running", PATIENCE_S)
    tab.wait_for_text("Nodes without problems", PATIENCE_S)
    shown(tab, shows_all)
    train.interrupt()
    tab.wait_for_text("The viewer has ended", PATIENCE_S)
    code, err = train.finish()
    assert code == 130
    assert "resume with: rkhs train --resume" in err
    assert (out / "policy.npz").exists()


def test_the_time_slider_moves_the_robot_of_a_finished_run(chromium: Browser, serve: Serve, folder: Path) -> None:
    view = serve("view", folder)
    tab = chromium.open(view.address)
    tab.wait_for_text("Finished: iteration 3 of 3", PATIENCE_S)
    shown(tab, shows_all)
    stop_playing(tab)
    slide(tab, 1, "Home")
    tab.wait_for_text("Step 1 of 100")
    first = settled(tab)
    assert np.array_equal(scene(first), scene(settled(tab)))
    slide(tab, 1, "End")
    tab.wait_for_text("Step 100 of 100")
    last = settled(tab)
    assert (scene(first) != scene(last)).any(axis=2).sum() > 1000
    view.interrupt()
    tab.wait_for_text("The viewer has ended")
    assert view.finish()[0] == 130


def test_the_scene_fits_into_the_first_window(chromium: Browser, serve: Serve, folder: Path) -> None:
    tab = chromium.open(serve("view", folder).address, 1280, 800)
    shown(tab, lambda picture: near(picture[:, :880], RED, 60) + near(picture[:, :880], BLUE, 60) > 8_000)
    stop_playing(tab)
    assert has_free_edges(settled(tab)[150:, :878])  # beside the panel, below the browser's notification


def test_a_recording_alone_shows_each_iteration(chromium: Browser, serve: Serve, folder: Path, tmp_path: Path) -> None:
    alone = tmp_path / "alone.mcap"
    shutil.copy(folder / "recording.mcap", alone)
    view = serve("view", alone)
    tab = chromium.open(view.address)
    tab.wait_for_text("Finished: iteration 3 of 3", PATIENCE_S)
    newest = shown(tab, shows_all)
    slide(tab, 0, "Home")
    shown(tab, lambda picture: (policy(picture) != policy(newest)).any(axis=2).sum() > 1000)


def settled(tab: Tab) -> np.ndarray:
    """Return a picture of the page once it no longer changes."""
    before = tab.picture()
    while True:
        time.sleep(0.5)
        now = tab.picture()
        if np.array_equal(scene(now), scene(before)):
            return now
        before = now
