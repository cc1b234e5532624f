"""Resets: the path home, and the order of the steps."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rkhs_ros.robot.reset import (
    Answer,
    CallService,
    Done,
    Failed,
    Home,
    HomingPath,
    Joints,
    Move,
    Reset,
    ResetProcess,
    Trigger,
    Wait,
)

HOME = Home(joints=("a", "b"), position=(0.0, 1.0), speed=(0.5, 2.0), stiffness=(20.0,), damping=(8.0,))
POSITIONS = st.lists(st.floats(-10, 10), min_size=2, max_size=2).map(np.array)
PERIOD = 0.02


@given(POSITIONS)
def test_no_joint_exceeds_its_speed_on_the_path_home(start: np.ndarray) -> None:
    way = HomingPath.home(HOME, start, now=5.0)
    moments = np.linspace(5.0, 5.0 + way.seconds, 200)
    np.testing.assert_allclose(way.at(5.0).position, start, atol=1e-9)
    np.testing.assert_allclose(way.at(99.0 + way.seconds).position, HOME.position, atol=1e-9)
    velocities = np.array([way.at(moment).velocity for moment in moments])
    assert (np.abs(velocities) <= np.array(HOME.speed) * (1 + 1e-9)).all()
    between = np.diff([way.at(moment).position for moment in moments], axis=0) / (moments[1] - moments[0])
    np.testing.assert_allclose(between, (velocities[1:] + velocities[:-1]) / 2, atol=1e-3)


def simulated(kind: str, start: np.ndarray, seconds: float = 60.0) -> tuple[np.ndarray, bool]:
    """Return the position of ideal joints after the reset, and whether the reset succeeded."""
    reset = ResetProcess(Reset(("home",), HOME), kind, "", now=0.0)
    position, velocity = start.copy(), np.zeros(2)
    for tick in range(round(seconds / PERIOD)):
        match reset.proceed(tick * PERIOD, lambda: Joints(position, velocity)):  # noqa: B023  # called here
            case Move(command):
                if kind == "effort":
                    velocity = velocity + PERIOD * command
                    position = position + PERIOD * velocity
                else:
                    velocity = (command - position) / PERIOD if kind == "position" else command
                    position = position + PERIOD * velocity
            case outcome:
                return position, isinstance(outcome, Done)
    return position, False


@pytest.mark.parametrize("kind", ["position", "velocity", "effort"])
def test_joints_of_each_kind_reach_home(kind: str) -> None:
    position, done = simulated(kind, np.array([2.0, -2.0]))
    assert done
    assert (np.abs(position - HOME.position) <= HOME.tolerance).all()


def test_a_failed_motion_home_names_the_joint() -> None:
    reset = ResetProcess(Reset(("home",), HOME), "position", "", now=0.0)
    stuck = Joints(np.array([2.0, 1.0]), np.zeros(2))
    assert isinstance(reset.proceed(0.0, lambda: stuck), Move)
    assert reset.proceed(31.0, lambda: stuck) == Failed("home: not settled within 30 s; a is 2 from home")


def test_reset_steps_run_in_order() -> None:
    reset = ResetProcess(Reset(("trigger", "person"), trigger=Trigger("tidy")), "position", "call me", now=0.0)
    no_joints = lambda: pytest.fail("nobody asked where the joints are")  # noqa: E731
    assert reset.proceed(0.0, no_joints) == CallService("tidy")
    assert reset.proceed(1.0, no_joints) == Wait()
    reset.answer = Answer(success=True, message="")
    reset.is_confirmed = True  # too early: nobody asked for it yet
    assert reset.proceed(2.0, no_joints) == Wait("prepare the scene, then run: call me")
    assert reset.proceed(3.0, no_joints) == Wait("prepare the scene, then run: call me")
    reset.is_confirmed = True
    assert reset.proceed(4.0, no_joints) == Done()


@pytest.mark.parametrize(
    ("answer", "reason"),
    [(Answer(success=False, message="no"), "tidy failed: no"), (None, "tidy did not answer within 60 s")],
)
def test_a_service_that_fails_fails_the_reset(answer: Answer | None, reason: str) -> None:
    reset = ResetProcess(Reset(("trigger",), trigger=Trigger("tidy")), "position", "", now=0.0)
    reset.proceed(0.0, lambda: Joints(np.zeros(1), np.zeros(1)))
    reset.answer = answer
    assert reset.proceed(61.0, lambda: Joints(np.zeros(1), np.zeros(1))) == Failed(reason)
