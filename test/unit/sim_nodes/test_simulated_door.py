"""The PR2's door in real time: each trajectory is one attempt."""

import math
from dataclasses import replace

import numpy as np
import pytest

from sim_nodes.pr2 import demonstration
from sim_nodes.robots.door import (
    CHOICES,
    CHOSEN,
    COMMANDED,
    KINDS,
    DoorSettings,
    Doorway,
    adapted_trajectory,
    motion_of,
)
from sim_nodes.robots.drives import JointCommand
from sim_nodes.robots.hardware import Hardware

pytest.importorskip("pybullet")

from sim_nodes.pr2.environment import POSE_SD, PR2Door
from sim_nodes.robots.door_robot import NAMES, DoorRobot

SHOWN = adapted_trajectory(np.zeros(2))
EXACT = DoorSettings(latency=0.0, jitter=0.0)
NONE = dict.fromkeys(KINDS, 0)


@pytest.fixture(scope="module")
def robot() -> DoorRobot:
    return DoorRobot(EXACT)


@pytest.fixture
def hardware(robot: DoorRobot) -> Hardware:
    robot.state = Doorway()
    return Hardware(robot)


def changed(**changes: object) -> JointCommand:
    return replace(SHOWN, **changes)


def with_value(value: float, knot: int = 30, joint: int = 1) -> JointCommand:
    rows = [list(row) for row in SHOWN.positions]
    rows[knot][joint] = value
    return changed(positions=tuple(map(tuple, rows)))


def test_a_trajectory_converts_to_its_original_motion() -> None:
    motion, shown = motion_of(SHOWN), demonstration.load()
    np.testing.assert_allclose(motion.arm, shown.arm, atol=1e-4)
    np.testing.assert_allclose(motion.openings, shown.openings, atol=1e-12)
    sparse = changed(times=SHOWN.times[::2], positions=SHOWN.positions[::2])
    assert len(motion_of(sparse).arm) == len(shown.arm)
    mixed = changed(names=COMMANDED[::-1], positions=tuple(row[::-1] for row in SHOWN.positions))
    np.testing.assert_array_equal(motion_of(mixed).arm, motion.arm)


def test_there_is_no_trajectory_for_an_unreachable_change() -> None:
    assert adapted_trajectory(np.array([2.0, 0.0])) is None


def test_an_attempt_ends_like_an_episode_of_the_task(hardware: Hardware, robot: DoorRobot) -> None:
    change = np.array([0.02, 0.01])
    begin = hardware.advance(1.0)[-1].readings
    assert begin.reward is None
    assert dict(zip(NAMES, begin.joints.positions, strict=True))["door_hinge"] == 0.0
    hardware.send(1.0, adapted_trajectory(change))
    samples = [sample for time in np.arange(1.0, 7.0, 0.5) for sample in hardware.advance(time)]
    angles = [sample.readings.joints.positions[NAMES.index("door_hinge")] for sample in samples]
    assert samples[-1].readings.reward is None  # 5.5 of 5.8 s
    last = hardware.advance(7.5)[-1].readings
    expected = PR2Door().attempt(POSE_SD * robot.base_error, change)
    assert last.reward == pytest.approx(expected.reward)
    assert last.joints.positions[NAMES.index("door_hinge")] == expected.door_angle
    assert max(angles[: len(angles) // 3]) < 1e-3  # shut while the arm approaches
    assert not robot.state.is_driven
    assert hardware.report()["violations"] == 0


BAD = {
    "other joints": ("malformed", changed(names=("a", *COMMANDED[1:]))),
    "too few": ("malformed", changed(positions=tuple(row[1:] for row in SHOWN.positions))),
    "no points": ("malformed", changed(times=(), positions=())),
    "later beginning": ("malformed", changed(times=tuple(time + 0.1 for time in SHOWN.times))),
    "too long": ("malformed", changed(times=tuple(10 * time for time in SHOWN.times))),
    "nan": ("non_finite", with_value(math.nan)),
    "out of range": ("position", with_value(1.5)),
    "too fast": ("velocity", with_value(1.0)),
    "far away": ("start", changed(positions=tuple((row[0] - 0.6, *row[1:]) for row in SHOWN.positions))),
}


@pytest.mark.parametrize(("kind", "command"), BAD.values(), ids=BAD)
def test_an_invalid_trajectory_is_counted_and_not_executed(kind: str, command: JointCommand) -> None:
    stopped = Doorway().heard(command, carry_out=lambda motion: pytest.fail("carried out"))
    assert stopped.protection.counts == {**NONE, kind: 1}
    assert not stopped.is_driven
    assert not stopped.heard(SHOWN, carry_out=lambda motion: pytest.fail("carried out")).is_driven


def test_each_attempt_requires_a_reset_of_the_door(hardware: Hardware, robot: DoorRobot) -> None:
    hardware.send(0.0, SHOWN)
    hardware.advance(1.0)
    hardware.send(1.0, SHOWN)
    before = hardware.advance(2.0)[-1].readings.joints.positions
    assert hardware.report()["not_reset"] == 1
    robot.reset()
    assert hardware.advance(3.0)[-1].readings.joints.positions == before  # halted for good
    robot.begin_episode()
    hardware.send(3.0, SHOWN)
    hardware.advance(4.0)
    assert robot.state.is_driven
    assert hardware.report()["violations"] == 1


@pytest.mark.parametrize(("pose", "poses"), [("per_run", 1), ("per_episode", 3)])
def test_the_pose_is_drawn_as_configured(robot: DoorRobot, pose: str, poses: int) -> None:
    fresh = DoorRobot(replace(EXACT, pose=pose))
    drawn = []
    for _ in range(3):
        drawn.append(tuple(fresh.base_error))
        fresh.begin_episode()
    assert len(set(drawn)) == poses
    assert drawn[0] == tuple(robot.base_error)


def test_a_resting_choice_opens_the_door_once_per_reset() -> None:
    robot = DoorRobot(replace(EXACT, controller=CHOICES))

    def hear(*choices: tuple[float, float]) -> None:
        times = tuple(0.1 * knot for knot in range(len(choices)))
        robot.hear(JointCommand(CHOSEN, times, choices))

    hear((0.0, 0.0))
    hear((0.01, 0.01), (0.02, 0.01))  # on its way
    assert robot.state.attempt is None
    hear((0.02, 0.01))
    attempt = robot.state.attempt
    assert attempt is not None
    other = DoorRobot(EXACT)
    other.hear(adapted_trajectory(np.array([0.02, 0.01])))
    assert other.state.attempt is not None
    assert attempt.reward == other.state.attempt.reward
    hear((0.05, 0.04))
    assert robot.state.attempt is attempt
    robot.begin_episode()
    assert robot.state.attempt is None
    assert dict(zip(*robot.sample().joints[:2], strict=True))["shift"] == 0.05
    hear((0.05, 0.04))
    assert robot.state.attempt is not None
    assert not any(robot.state.protection.counts.values())
    robot.hear(SHOWN)
    assert robot.state.protection.counts["malformed"] == 1
