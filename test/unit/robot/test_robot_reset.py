"""Resets: the path home, and the order of the steps."""

from collections.abc import Iterator
from concurrent.futures import Future
from types import SimpleNamespace as Answer
from typing import Any

import numpy as np
import pytest
from hypothesis import given, strategies as st

from rkhs_ros.robot.reset import Home, Joints, Means, Reset, ResetError, Trigger, path_home, reset_steps

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


class Robot:
    """Ideal joints, a clock that advances with each command, and an operator."""

    def __init__(self, kind: str, start: np.ndarray) -> None:
        self.kind, self.position, self.velocity = kind, start, np.zeros(2)
        self.now, self.confirmations = 0.0, 0
        self.answers: list[Future[Any]] = []

    def begin(self, reset: Reset) -> Iterator[np.ndarray | str]:
        return reset_steps(
            reset,
            Means(
                self.kind,
                lambda: self.now,
                lambda: Joints(self.position, self.velocity),
                self._call,
                "prepare the scene",
                lambda: self.confirmations,
            ),
        )

    def obey(self, command: np.ndarray) -> None:
        if self.kind == "effort":
            self.velocity = self.velocity + PERIOD * command
        else:
            self.velocity = (command - self.position) / PERIOD if self.kind == "position" else command
        self.position = self.position + PERIOD * self.velocity
        self.now += PERIOD

    def _call(self) -> Future[Any]:
        self.answers.append(Future())
        return self.answers[-1]


@pytest.mark.parametrize("kind", ["position", "velocity", "effort"])
def test_joints_of_each_kind_reach_home(kind: str) -> None:
    robot = Robot(kind, np.array([2.0, -2.0]))
    for command in robot.begin(Reset(("home",), HOME)):
        assert isinstance(command, np.ndarray)
        robot.obey(command)
    assert (np.abs(robot.position - HOME.position) <= HOME.tolerance).all()
    assert robot.now < HOME.timeout


def test_a_failed_motion_home_names_the_joint() -> None:
    robot = Robot("position", np.array([2.0, 1.0]))
    reset = robot.begin(Reset(("home",), HOME))
    np.testing.assert_array_equal(next(reset), robot.position)
    robot.now = 31.0
    with pytest.raises(ResetError, match="home: not settled within 30 s; a is 2 from home"):
        next(reset)


def test_reset_steps_run_in_order() -> None:
    robot = Robot("position", np.zeros(2))
    reset = robot.begin(Reset(("trigger", "person"), trigger=Trigger("tidy")))
    assert [next(reset), next(reset), len(robot.answers)] == ["", "", 1]
    robot.answers[0].set_result(Answer(success=True))
    robot.confirmations += 1  # too early: nobody asked for it yet
    assert [next(reset), next(reset)] == ["prepare the scene"] * 2
    robot.confirmations += 1
    assert next(reset, None) is None


@pytest.mark.parametrize(
    ("answer", "reason"),
    [(Answer(success=False, message="no"), "tidy failed: no"), (None, "tidy did not answer within 60 s")],
)
def test_a_service_that_fails_fails_the_reset(answer: Answer | None, reason: str) -> None:
    robot = Robot("position", np.zeros(2))
    reset = robot.begin(Reset(("trigger",), trigger=Trigger("tidy")))
    next(reset)
    robot.now = 61.0
    if answer is not None:
        robot.answers[0].set_result(answer)
    with pytest.raises(ResetError, match=reason):
        next(reset)
