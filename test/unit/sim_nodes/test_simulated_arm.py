"""The simulated arm without ROS: drives, protective stops, the mark, and the body in PyBullet."""

import math
from dataclasses import replace

import numpy as np
import pytest

from sim_nodes.robots.arm import CENTRE, HOME, ArmRobot, ArmSettings, first_phase, mark_at
from sim_nodes.robots.drives import BANDWIDTH, KINDS, DriveLimits, Drives, JointCommand
from sim_nodes.robots.robot import Hardware

STEP = 1.0 / 240.0  # s
LIMITS = DriveLimits(*(np.array(pair) for pair in ((-1.0, -2.0), (1.0, 2.0), (2.0, 2.0), (25.0, 25.0), (0.1, 0.05))))
STILL = Drives(("a", "b"), LIMITS, np.zeros(2), np.zeros(2))
NONE = dict.fromkeys(KINDS, 0)


def moved(drives: Drives, seconds: float) -> Drives:
    for _ in range(round(seconds / STEP)):
        drives = drives.stepped(STEP)
    return drives


def at(*positions: float) -> JointCommand:
    return JointCommand((), (0.0,), (positions,))


def test_the_motion_equals_a_critically_damped_filter() -> None:
    drives = STILL.heard(at(0.1, 0.05))
    for number in range(1, 100):
        drives = drives.stepped(STEP)
        w_t = BANDWIDTH * number * STEP
        np.testing.assert_allclose(drives.position, np.array([0.1, 0.05]) * (1 - (1 + w_t) * math.exp(-w_t)))
        np.testing.assert_allclose(drives.velocity, np.array([0.1, 0.05]) * BANDWIDTH * w_t * math.exp(-w_t))
    assert drives.protection.counts == NONE


def test_a_trajectory_starts_at_the_current_set_point() -> None:
    drives = STILL.heard(JointCommand(("b", "a"), (0.5, 1.0), ((0.5, 0.25), (0.5, 0.5))))
    np.testing.assert_allclose(moved(drives, 0.25).target, [0.125, 0.25])
    np.testing.assert_allclose(moved(drives, 1.0).target, [0.5, 0.5])
    np.testing.assert_allclose(moved(drives, 3.0).position, [0.5, 0.5], atol=1e-6)
    turned = moved(drives, 0.25).heard(JointCommand(("a", "b"), (0.5,), ((0.0, 0.0),)))  # a new one takes its place
    np.testing.assert_allclose(moved(turned, 0.25).target, [0.0625, 0.125])
    assert turned.protection.counts == NONE


BAD = {
    "too few": ("malformed", at(0.0)),
    "another joint": ("malformed", JointCommand(("a", "c"), (1.0,), ((0.0, 0.0),))),
    "back in time": ("malformed", JointCommand((), (1.0, 1.0), ((0.0, 0.0), (0.0, 0.0)))),
    "nan": ("non_finite", at(0.0, math.nan)),
    "infinite later": ("non_finite", JointCommand((), (0.0, 1.0), ((0.0, 0.0), (0.0, math.inf)))),
    "out of range": ("position", at(1.01, 0.0)),
    "out of range later": ("position", JointCommand((), (1.0, 9.0), ((0.0, 0.0), (0.0, -2.1)))),
    "jump": ("step", at(0.0, 0.06)),
    "too fast": ("step", JointCommand((), (0.1,), ((0.31, 0.0),))),
}


@pytest.mark.parametrize(("kind", "command"), BAD.values(), ids=BAD)
def test_a_bad_command_stops_the_arm_and_is_counted(kind: str, command: JointCommand) -> None:
    moving = moved(STILL.heard(at(0.1, 0.05)), 0.1)
    assert np.abs(moving.velocity).min() > 0.1
    far = moving if kind != "step" else STILL
    stopped = far.heard(command)
    assert stopped.protection.counts == {**NONE, kind: 1}
    assert stopped.protection.reason.startswith(f"{kind}: ")
    assert not moved(stopped, 0.2).velocity.any()
    assert stopped.heard(at(0.1, 0.05)).set_points is None  # the stop latches until it is reset
    assert stopped.reset().heard(at(*stopped.position)).set_points is not None


@pytest.mark.parametrize("kind", ["velocity", "acceleration"])
def test_an_excessive_velocity_stops_the_arm_once(kind: str) -> None:
    limits = replace(LIMITS, velocity=np.full(2, 9.0), acceleration=np.full(2, 900.0))
    drives = replace(STILL, limits=replace(limits, **{kind: np.full(2, 0.5)}))
    stopped = moved(drives.heard(JointCommand((), (0.1,), ((0.1, 0.0),))), 1.0)
    assert stopped.protection.counts == {**NONE, kind: 1}
    assert "a: expected at most 0.5 rad/s" in stopped.protection.reason
    assert not stopped.velocity.any()


@pytest.fixture
def arm() -> ArmRobot:
    pytest.importorskip("pybullet")
    return ArmRobot(ArmSettings(position_noise=0.0, velocity_noise=0.0, latency=0.0, jitter=0.0))


def test_the_body_holds_against_gravity_and_follows_its_drives(arm: ArmRobot) -> None:
    hardware = Hardware(arm)
    held = hardware.advance(0.5)[-1][1].joints
    np.testing.assert_allclose(held.positions, HOME, atol=1e-3)
    assert abs(held.efforts[1]) > 5.0  # the shoulder bears the arm
    for number in range(1, 51):
        time = 0.5 + 0.02 * number
        hardware.send(time - 0.02, at(*(HOME + 0.004 * number)))
        joints = hardware.advance(time)[-1][1].joints
        np.testing.assert_allclose(joints.positions, arm.state.position, atol=0.02)
    last = hardware.advance(2.5)[-1][1].joints
    np.testing.assert_allclose(last.positions, HOME + 0.2, atol=2e-3)
    assert hardware.report()["violations"] == 0


def test_the_mark_restarts_with_each_episode(arm: ArmRobot) -> None:
    hardware = Hardware(arm)
    hardware.advance(0.3)
    arm.begin_episode()
    begin = hardware.time
    time, readings = hardware.advance(0.5)[-1]
    np.testing.assert_allclose(readings.mark, mark_at(time - begin, first_phase(0, 1)))
    assert np.linalg.norm(np.subtract(readings.tool.position, CENTRE)) < 0.1  # at home it is near the path
    assert math.hypot(*readings.tool.orientation) == pytest.approx(1.0)
