"""The table of tasks in benchmarks/."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import tasks
from task_learners import LEARNERS
from trial import TASKS, Key, Point, read_curves, write_curves


@pytest.mark.parametrize("name", TASKS)
def test_every_task_has_settings_that_fit(name: str) -> None:
    if not tasks.missing(TASKS[name].packages):
        for learner in LEARNERS:
            trial = tasks.trial_of(TASKS[name], learner, 3)
            assert trial.config.training.seed == 3
            assert trial.episodes == (TASKS[name].episodes if learner == "ours" else 100)


def curve(returns: list[float]) -> list[Point]:
    """Return a curve with a point every two episodes of seven steps."""
    return [Point(2 * i, 14 * i, 0.5 * i, each, each, each, 0.0, 1) for i, each in enumerate(returns, 1)]


def test_curves_are_the_same_after_storing_them(tmp_path: Path) -> None:
    keys = [Key("tanks", "ours", 2), Key("tanks", "sac", 1), Key("tanks", "sac", 0)]
    curves = {key: curve([float(key.seed), -5.0]) for key in keys}
    write_curves(tmp_path / "curves.csv", curves)
    assert read_curves(tmp_path / "curves.csv") == curves
    assert tasks.repeat_of(curves, "tanks") == 1
    assert tasks.repeat_of(curves, "cart-pole") is None


@given(st.lists(st.floats(0.0, 60.0), min_size=1, max_size=12))
def test_a_threshold_is_reached_at_the_first_point_that_is_not_below_it(returns: list[float]) -> None:
    cell = tasks.Cell(TASKS["cart-pole"], [curve(returns)])
    until = [count for count, each in zip(range(2, 99, 2), returns, strict=False) if each >= 45.0]
    assert cell.until(45.0, "episodes").value == min(until, default=np.inf)
    assert cell.until(45.0, "steps").value == 7 * min(until, default=np.inf)
    np.testing.assert_equal(cell.after(10), [returns[4] if len(returns) > 4 else np.nan])
    if until:
        later = returns[until[0] // 2 :]
        assert cell.below(45.0) == (f"{np.mean(np.array(later) < 45.0):.0%}" if later else "-")


def test_the_table_counts_seeds_that_never_reach_a_threshold() -> None:
    curves = {Key("cart-pole", "sac", seed): curve([10.0, 46.0 if seed < 1 else 3.0]) for seed in range(3)}
    cell = tasks.cells_of(curves)["cart-pole"]["sac"]
    assert tasks.shown(cell.until(45.0, "episodes")) == "never [4, never]"


@pytest.mark.filterwarnings("ignore::scipy.stats.DegenerateDataWarning")
def test_table_and_page_are_those_of_the_stored_curves() -> None:
    cells = tasks.cells_of(read_curves(tasks.CURVES))
    assert tasks.TABLE.read_text() == tasks.text_of_table(cells)
    assert tasks.PAGE.read_text() == tasks.page_with(tasks.overview(cells))
