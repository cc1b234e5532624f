"""Default settings for an untuned task, from the command line and in the library."""

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import rkhs_ros
from rkhs_ros.learning.training_settings import ModelBased, Training
from rkhs_ros.runs.config import config_for
from rkhs_ros.runs.defaults import settings_for


def training_on(horizon: int | None, *changes: str) -> Training:
    return config_for("rkhs/Toy-v0", horizon, changes).training


@given(st.integers(1, 10**6), st.integers(1, 10**6))
def test_the_discount_rises_with_the_horizon_and_stays_below_1(one: int, other: int) -> None:
    discounts = [settings_for(horizon=horizon)["discount"] for horizon in sorted((one, other))]
    assert 0.99 <= discounts[0] <= discounts[1] < 1.0


def test_the_horizon_of_the_settings_determines_the_discount() -> None:
    assert training_on(None).discount == 0.99
    assert training_on(1000).discount == 0.996
    assert (training_on(None, "horizon=1000").horizon, training_on(None, "horizon=1000").discount) == (1000, 0.996)
    assert training_on(1000, "horizon=100").discount == 0.99
    assert training_on(1000, "discount=0.9").discount == 0.9
    assert training_on(1000, "discount=0.9", "horizon=500").discount == 0.9


@pytest.mark.parametrize(("horizon", "form"), [(100, "gaussian_process"), (np.int64(1000), "none")])
def test_the_command_line_and_the_library_have_the_same_defaults(horizon: Any, form: str) -> None:
    small: dict[str, Any] = {"iterations": 1, "episodes_per_iteration": 1, "evaluate_every": 0}
    changes = [f"{name}={value}" for name, value in small.items()]
    training = training_on(None, f"horizon={horizon}", f"model.form={form}", *changes)
    model = "none" if form == "none" else ModelBased(updates=1, rollouts=2, centres=5)
    result = rkhs_ros.train("rkhs/Toy-v0", model=model, horizon=horizon, progress=False, **small)
    assert (result.policy.task.horizon, result.policy.task.discount) == (training.horizon, training.discount)
