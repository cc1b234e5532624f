"""The page of a run: over topics during the run, from its folder afterwards, and from its recording alone."""

import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from browser import Browser, Tab, each

from rkhs_ros.runs.config import load_config
from rkhs_ros.runs.run import run_training
from test.view.conftest import PATIENCE_S, Viewing, near, panel, policy, scene, shown

CONFIGS = Path(__file__).parents[2] / "config"
EVALUATION, RED, BLUE = (0, 114, 178), (180, 4, 38), (59, 76, 192)
ORANGE = ((180, 60, 0), (255, 190, 110))  # range of the colours of the torque's arc, in light and shade
Serve = Callable[..., Viewing]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A finished run with a recording."""
    from rkhs_ros.app.inline import runner_of

    config = load_config(CONFIGS / "pendulum_few_nac.yaml", ["iterations=3"])
    path = tmp_path_factory.mktemp("page") / "run"
    return run_training(config, runner_of(config.environment), path, quiet=True)


def shows_policy(picture: np.ndarray) -> bool:
    return near(policy(picture), RED, 60) + near(policy(picture), BLUE, 60) > 8_000


def shows_pendulum(picture: np.ndarray) -> bool:
    low, high = ORANGE
    return int(((scene(picture) >= low) & (scene(picture) <= high)).all(axis=2).sum()) > 100


def shows_curve(picture: np.ndarray) -> bool:
    return near(panel(picture), EVALUATION, 30) > 150


def shows_all(picture: np.ndarray) -> bool:
    return shows_policy(picture) and shows_pendulum(picture) and shows_curve(picture)


def stop_playing(tab: Tab) -> None:
    play = f"{each('input[type=checkbox]')}[0]"
    tab.click_on(play)
    tab.wait_for(f"!{play}.checked")


def slide(tab: Tab, number: int, key: str) -> None:
    """Move a slider to one of its ends: Home or End."""
    tab.press(f"{each('[role=slider]')}[{number}]", key)


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


def settled(tab: Tab) -> np.ndarray:
    """Return a picture of the page once it no longer changes."""
    before = tab.picture()
    while True:
        time.sleep(0.5)
        now = tab.picture()
        if np.array_equal(scene(now), scene(before)):
            return now
        before = now
