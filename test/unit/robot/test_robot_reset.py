"""Resets: the path home, and the order of the steps."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rkhs_ros.robot.reset import Home, Joints, Reset, ResetError, ResetProcess, Trigger, path_home

HOME = Home(joints=("a", "b"), position=(0.0, 1.0), speed=(0.5, 2.0), stiffness=(20.0,), damping=(8.0,))
POSITIONS = st.lists(st.floats(-10, 10), min_size=2, max_size=2).map(np.array)
PERIOD = 0.02


@given(POSITIONS)
def test_no_joint_exceeds_its_speed_on_the_path_home(start: np.ndarray) -> None:
    np.testing.assert_array_equal(path_home(HOME, start, 0.0)[0].position, start)
    moments = np.linspace(0.0, 40.0, 1000)
    wanted, ended = zip(*(path_home(HOME, start, moment) for moment in moments), strict=True)
    np.testing.assert_allclose(wanted[ended.index(True)].position, HOME.position, atol=1e-9)
    velocities = np.array([each.velocity for each in wanted])
    assert (np.abs(velocities) <= np.array(HOME.speed) * (1 + 1e-9)).all()
    between = np.diff([each.position for each in wanted], axis=0) / (moments[1] - moments[0])
    np.testing.assert_allclose(between, (velocities[1:] + velocities[:-1]) / 2, atol=0.05)


def never() -> None:
    pytest.fail("nobody asked for it")


def simulated(kind: str, start: np.ndarray, seconds: float = 60.0) -> tuple[np.ndarray, bool]:
    """Return the position of ideal joints after the reset, and whether the reset succeeded."""
    reset = ResetProcess(Reset(("home",), HOME), kind, "", 0.0, never)
    position, velocity = start.copy(), np.zeros(2)
    for tick in range(round(seconds / PERIOD)):
        command = reset.proceed(tick * PERIOD, lambda: Joints(position, velocity))  # noqa: B023  # called here
        if command is None:
            return position, True
        if kind == "effort":
            velocity = velocity + PERIOD * command
        else:
            velocity = (command - position) / PERIOD if kind == "position" else command
        position = position + PERIOD * velocity
    return position, False


@pytest.mark.parametrize("kind", ["position", "velocity", "effort"])
def test_joints_of_each_kind_reach_home(kind: str) -> None:
    position, done = simulated(kind, np.array([2.0, -2.0]))
    assert done
    assert (np.abs(position - HOME.position) <= HOME.tolerance).all()


def test_a_failed_motion_home_names_the_joint() -> None:
    reset = ResetProcess(Reset(("home",), HOME), "position", "", 0.0, never)
    stuck = Joints(np.array([2.0, 1.0]), np.zeros(2))
    np.testing.assert_array_equal(reset.proceed(0.0, lambda: stuck), stuck.position)
    with pytest.raises(ResetError, match="home: not settled within 30 s; a is 2 from home"):
        reset.proceed(31.0, lambda: stuck)


def test_reset_steps_run_in_order() -> None:
    calls: list[str] = []
    steps = Reset(("trigger", "person"), trigger=Trigger("tidy"))
    reset = ResetProcess(steps, "position", "call me", 0.0, lambda: calls.append("tidy"))
    assert [reset.proceed(at, never) for at in (0.0, 1.0)] == ["", ""]
    assert calls == ["tidy"]
    reset.answer = (True, "")
    reset.is_confirmed = True  # too early: nobody asked for it yet
    assert [reset.proceed(at, never) for at in (2.0, 3.0)] == ["prepare the scene, then run: call me"] * 2
    reset.is_confirmed = True
    assert reset.proceed(4.0, never) is None


@pytest.mark.parametrize(
    ("answer", "reason"), [((False, "no"), "tidy failed: no"), (None, "tidy did not answer within 60 s")]
)
def test_a_service_that_fails_fails_the_reset(answer: tuple[bool, str] | None, reason: str) -> None:
    reset = ResetProcess(Reset(("trigger",), trigger=Trigger("tidy")), "position", "", 0.0, lambda: None)
    reset.proceed(0.0, never)
    reset.answer = answer
    with pytest.raises(ResetError, match=reason):
        reset.proceed(61.0, never)
