"""The page of a run as a self-contained HTML file."""

import re
from base64 import b64decode
from collections.abc import Callable
from html import unescape
from pathlib import Path
from typing import Any

import pytest

from rkhs_ros.app.inline import runner_of
from rkhs_ros.runs.config import load_config
from rkhs_ros.runs.run import run_training

pytestmark = pytest.mark.slow

CONFIGS = Path(__file__).parents[3] / "config"


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A finished run."""
    config = load_config(CONFIGS / "pendulum_few_nac.yaml", ["iterations=2", "horizon=12"])
    return run_training(config, runner_of(config.environment), tmp_path_factory.mktemp("page") / "run", quiet=True)


def test_a_run_is_exported_as_a_page_that_needs_no_other_file(
    rkhs: Callable[..., Any], folder: Path, tmp_path: Path
) -> None:
    result = rkhs("export", folder, tmp_path / "run.html")
    assert (result.code, result.err) == (0, "")
    assert result.out == f"Exported the page of the run: {tmp_path / 'run.html'}\n"
    page = (tmp_path / "run.html").read_text()
    assert "Finished: iteration 2 of 2</p><p>10 episodes, " in page
    (picture,) = re.findall(r'src="data:image/png;base64,([^"]+)"', page)
    assert b64decode(picture).startswith(b"\x89PNG")
    (scene,) = re.findall(r'srcdoc="([^"]+)"', page)
    assert unescape(scene).lstrip().lower().startswith("<!doctype html>")
    outside = [link for link in re.findall(r'(?:src|href)="([^"]*)"', page) if not link.startswith("data:")]
    assert outside == []
