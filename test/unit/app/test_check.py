"""``rkhs check``: what a few exploring episodes reveal about a task."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from rkhs_ros.app.task_check import TaskCheck
from rkhs_ros.learning.episodes import Episodes
from rkhs_ros.policies.spaces import Spaces
from test.unit.conftest import model_free

Rkhs = Callable[..., Any]
CONFIGS = Path(__file__).parents[3] / "config"


def table(out: str) -> dict[str, str]:
    """Return the values by name, and the last line as "last"."""
    *lines, last = out.splitlines()
    return {"last": last} | {name: value for name, _, value in (line.partition("  ") for line in lines)}


def checked(rkhs: Rkhs, *arguments: object) -> dict[str, str]:
    result = rkhs("check", *arguments)
    assert (result.code, result.err) == (0, "")
    return {name: value.strip() for name, value in table(result.out).items()}


def test_a_wrapped_angle_is_found_and_a_file_gets_its_settings(rkhs: Rkhs) -> None:
    wrapped = "environment.options.angle=wrap"
    assert checked(rkhs, "rkhs/Pendulum-v0", "--set", wrapped)["angles"].startswith("0 ")
    values = checked(rkhs, CONFIGS / "pendulum_nac.yaml", "--set", wrapped)
    assert values["angles"].endswith("in radians")
    assert "'inputs.angles=[0]'" in values["last"]
    assert values["last"].startswith("try: --set ")


@pytest.mark.parametrize(
    "fixed",
    [
        ("kernel={form: monomials, degree: 2}",),
        ("algorithm={name: enac, grid: [-4, 4, 3, -9, 9, 4]}", "kernel.bandwidth=1.0"),
    ],
)
def test_inputs_that_training_keeps_are_not_searched(rkhs: Rkhs, fixed: tuple[str, ...]) -> None:
    wrapped = "environment.options.angle=wrap"
    values = checked(rkhs, CONFIGS / "pendulum_nac.yaml", "--set", wrapped, *fixed)
    not_tested = "not tested, since kernel.form, the grid or kernel.bandwidth depends on the inputs"
    assert values["angles"] == values["history"] == not_tested
    assert "inputs" not in values["last"]


@pytest.mark.parametrize(("frequency", "fast"), [(0.088, False), (0.105, True)])  # changes of 0.55 and 0.65
def test_a_task_whose_state_changes_too_fast_is_named(frequency: float, fast: bool) -> None:
    phase = 2.0 * np.pi * frequency * np.arange(400)
    observed = np.stack([np.sin(phase), np.cos(phase)], axis=1)[None]
    rng, ones = np.random.default_rng(0), np.ones((1, 400), dtype=bool)
    actions, rewards = rng.uniform(-1.0, 1.0, (1, 400, 1)), observed[..., 0]
    episodes = Episodes.without_ends(observed, actions, rewards, ones)
    checked = TaskCheck.of(episodes, model_free(), Spaces((2,), -np.ones(1), np.ones(1)))
    assert ("change per decision: run the task at a higher control rate" in checked.problems()) == fast
