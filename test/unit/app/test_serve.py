"""Serving a Python function: valid and invalid actions."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from gymnasium.spaces import Box

from rkhs_ros.app.commands.serve import action_of
from rkhs_ros.base.endings import RunError
from test.unit.conftest import Result, assert_refused

SPACE = Box(np.array([-1.0, 0.0], np.float32), np.array([1.0, np.inf], np.float32))
OBSERVATION = np.array([0.5, 2.0, 3.0])


@pytest.mark.parametrize("answer", [[0.5, 2.0], (0.5, 2), np.array([[0.5, 2.0]]), np.array([0.5, 2.0], np.float32)])
def test_actions_may_have_any_numeric_type(answer: Any) -> None:
    action = action_of(lambda observation: answer, OBSERVATION, SPACE, "mine:act")
    np.testing.assert_array_equal(action, np.array([0.5, 2.0], np.float32), strict=True)


@pytest.mark.parametrize(
    ("answer", "got"),
    [
        ([0.5], "float64 of shape (1,)"),
        (None, "object of shape ()"),
        ("left", "<U4 of shape ()"),
        ([1.5, 0.0], "[1.5 0. ]"),
        ([0.0, -1e-9], "[ 0.e+00 -1.e-09]"),
        ([np.nan, 0.0], "[nan 0.]"),
        ([0.0, np.inf], "[ 0. inf]"),
    ],
)
def test_invalid_actions_are_rejected(answer: Any, got: str) -> None:
    with pytest.raises(RunError) as refused:
        action_of(lambda observation: answer, OBSERVATION, SPACE, "mine:act: step 3")
    assert str(refused.value) == f"mine:act: step 3: expected an action of shape (2,) within its bounds, got {got}"


def test_an_error_contains_the_function_and_the_step() -> None:
    with pytest.raises(RunError, match=r"^mine:act: step 3: ZeroDivisionError: division by zero$"):
        action_of(lambda observation: 1 / 0, OBSERVATION, SPACE, "mine:act: step 3")


def test_a_function_cannot_change_the_observation() -> None:
    def act(observation: Any) -> Any:
        observation[:] = 0.0
        return [0.0, 0.0]

    action_of(act, OBSERVATION, SPACE, "mine:act")
    assert OBSERVATION.tolist() == [0.5, 2.0, 3.0]


def test_bad_options_are_rejected(rkhs: Callable[..., Result]) -> None:
    assert_refused(rkhs("serve", "math:sine"), "no function 'sine' in math, did you mean")
    assert_refused(rkhs("serve", "math:sin", "--episodes", 0), "--episodes: expected at least 1, got 0")
    assert_refused(rkhs("simulate"), "simulate: expected either CONFIG or --env ID, got none")
    assert_refused(rkhs("simulate", "--env", "rkhs/Pendulm-v0"), "did you mean 'rkhs/Pendulum-v0'?")
