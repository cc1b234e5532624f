"""The settings of a robot's task: commands, rules and validation."""

import signal
import threading
from contextlib import suppress
from typing import Any

import numpy as np
import pytest
from hypothesis import given, strategies as st

from rkhs_ros.base.endings import RunError
from rkhs_ros.robot.task import Commands, End, Reward, robot_task_from
from test.unit.robot.test_gate_settings import merged

HERE = "test.unit.robot.test_robot_task"
SECTION: dict[str, Any] = {
    "task": "arm",
    "sensors": {"joints": {"topic": "joint_states", "joints": ["a", "b"]}},
    "action": {"minimum": [-1.0, -2.0], "maximum": [1.0, 2.0]},
    "reward": {"function": f"{HERE}:squares"},
}
FINITE = st.floats(-1e3, 1e3)


def squares(before: np.ndarray, action: np.ndarray, after: np.ndarray) -> float:
    return float(before @ before + action @ action + after @ after)


def broken(before: np.ndarray, action: np.ndarray, after: np.ndarray) -> float:
    raise ZeroDivisionError("by nothing")


def spoilt(before: np.ndarray, action: np.ndarray, after: np.ndarray) -> float:
    before[:] = np.nan
    return float(before[0])


def hangs(before: np.ndarray, action: np.ndarray, after: np.ndarray) -> float:
    with suppress(Exception):
        threading.Event().wait(60.0)
    return 0.0


def beyond(before: np.ndarray, action: np.ndarray, after: np.ndarray) -> int:
    return 10**400


@pytest.mark.parametrize(
    ("path", "value", "message"),
    [
        ("period", 0.0, "period: expected a number in"),
        ("task", "a task", "task: expected a name"),
        ("sensors", None, "sensors: expected a section for each sensor"),
        ("sensors.joints.fields", ["posit"], "sensors.joints: fields: expected some of position"),
        ("action.minimum", [1.0, 0.0], "action.minimum: expected less than action.maximum"),
        ("action.scale", [0.0, 1.0], "action.scale: expected nonzero numbers"),
        ("action.scale", [1.0, 1.0, 1.0], "action.scale: expected 1 or 2 numbers, got 3"),
        ("reward.function", None, "reward: expected a function or a topic"),
        ("reward.function", "nowhere:f", "reward.function: expected an importable module 'nowhere', "),
        ("reset.steps", ["trigger"], "reset.trigger.service: expected the name of a service"),
        ("reset", {"steps": ["home"], "home": {"joints": ["a"]}}, "reset.home.joints: expected 2, one for each"),
    ],
)
def test_invalid_settings_are_refused_in_one_line(path: str, value: object, message: str) -> None:
    for name in reversed(path.split(".")):
        value = {name: value}
    assert isinstance(value, dict)
    with pytest.raises(ValueError, match=r"expected|unknown|no function") as refusal:
        robot_task_from(merged(SECTION, value))
    assert message in str(refusal.value)
    assert "\n" not in str(refusal.value)


@given(st.lists(FINITE, min_size=2, max_size=2), st.lists(st.floats(0.1, 10.0), min_size=2, max_size=2))
def test_commands_stay_within_the_mapped_bounds(action: list[float], scale: list[float]) -> None:
    commands = Commands((-1.0, -2.0), (1.0, 2.0), tuple(scale), (0.5,))
    low, high = (commands.command(np.array(bound)) for bound in (commands.minimum, commands.maximum))
    command = commands.command(np.array(action))
    assert (low <= command).all()
    assert (command <= high).all()
    np.testing.assert_allclose(commands.action(command), np.clip(action, [-1, -2], [1, 2]), atol=1e-9)


def test_the_reward_is_the_sum_of_function_and_topic() -> None:
    reward = Reward(function=f"{HERE}:squares")
    ones = np.ones(2)
    assert reward.of(10.0, ones, ones, ones) == 16.0
    assert not End().is_reached(ones, ones, ones)


@pytest.mark.parametrize(("answer", "ends"), [(True, True), (np.False_, False), (np.array([True]), True)])
def test_an_end_is_a_boolean(answer: object, ends: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(globals(), "answered", lambda *arrays: answer)
    end, ones = End(function=f"{HERE}:answered"), np.ones(2)
    assert end.is_reached(ones, ones, ones) is ends


@pytest.mark.parametrize("answer", [None, "no", 0.3, np.ones(2, dtype=bool)])
def test_another_answer_than_a_boolean_is_reported(answer: object, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(globals(), "answered", lambda *arrays: answer)
    end, ones = End(function=f"{HERE}:answered"), np.ones(2)
    with pytest.raises(RunError, match="end function: expected True or False, got "):
        end.is_reached(ones, ones, ones)


@pytest.mark.parametrize(
    ("name", "message"),
    [("broken", "ZeroDivisionError: by nothing"), ("spoilt", "finite"), ("beyond", "expected a number, got 1000")],
)
def test_a_failing_reward_is_reported_and_cannot_edit_our_arrays(name: str, message: str) -> None:
    reward, ones = Reward(function=f"{HERE}:{name}"), np.ones(2)
    with pytest.raises(RunError, match=message):
        reward.of(0.0, ones, ones, ones)
    np.testing.assert_array_equal(ones, 1.0)


def test_a_hanging_reward_is_reported_and_an_earlier_alarm_stays_set(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("rkhs_ros.robot.task.ANSWER_TIMEOUT_S", 0.05)
    reward, ones = Reward(function=f"{HERE}:hangs"), np.ones(2)
    before = signal.setitimer(signal.ITIMER_REAL, 1000.0)
    try:
        with pytest.raises(RunError, match=r"reward function: did not return within 0\.05 s"):
            reward.of(0.0, ones, ones, ones)
        assert signal.getitimer(signal.ITIMER_REAL)[0] > 900.0
    finally:
        signal.setitimer(signal.ITIMER_REAL, *before)
