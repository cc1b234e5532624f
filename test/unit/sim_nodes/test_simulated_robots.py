"""Simulated robots without ROS: physics, wires, protective stops and their counters."""

import math
import re
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
import yaml
from hypothesis import given, strategies as st

from rkhs_ros.base.settings import entries
from rkhs_ros.policies.streams import stream
from sim_nodes.envs.lever_stafford import Pendulum
from sim_nodes.robots import SETTINGS, drives, settings_of
from sim_nodes.robots.motor_pendulum import (
    BRAKE,
    KINDS,
    PAPER_NOISE,
    MotorLimits,
    MotorPendulum,
    MotorPendulumRobot,
    MotorPendulumSettings,
)
from sim_nodes.robots.robot import MOST_CATCH_UP_S, Hardware, JointReadings, Wire

PAGE = (Path(__file__).parents[3] / "docs" / "simulated_robots.md").read_text()
STEP = 0.002  # s
NOISY = MotorPendulumSettings(seed=5, latency=0.004, jitter=0.01, loss=0.2)
torques = st.floats(-3.0, 3.0)
times = st.lists(st.floats(0.0, 0.2), max_size=8).map(lambda gaps: np.cumsum([0.0, *gaps]).tolist())


def steps(pendulum: MotorPendulum, count: int) -> MotorPendulum:
    for _ in range(count):
        pendulum = pendulum.stepped(STEP)
    return pendulum


@given(torques, st.integers(1, 500))
def test_a_torque_moves_the_pendulum_as_a_double_integrator(torque: float, count: int) -> None:
    after = steps(MotorPendulum(angle=0.0).heard([torque]), count)
    time = count * STEP
    assert after.velocity == pytest.approx(torque * time, abs=1e-9)
    assert after.angle == pytest.approx(0.5 * torque * time**2, abs=1e-9)


@given(st.floats(-12.0, 12.0))
def test_the_brake_brings_the_pendulum_to_rest_in_the_expected_time(velocity: float) -> None:
    pendulum = MotorPendulum(angle=0.0, velocity=velocity)
    needed = math.ceil(abs(velocity) / BRAKE / STEP)
    speeds = [abs(velocity)] + [abs((pendulum := pendulum.stepped(STEP, kick=1.0)).velocity) for _ in range(needed)]
    assert speeds == sorted(speeds, reverse=True)
    assert pendulum.velocity == pytest.approx(0.0, abs=1e-12)  # the steps of the brake are rounded
    assert pendulum.stepped(STEP).angle == pytest.approx(pendulum.angle, abs=1e-12)


def test_an_action_has_the_same_effect_as_in_the_papers_task() -> None:
    task, pendulum = Pendulum(), MotorPendulum()
    states = task.initial_states(np.empty((1, 0)))
    for torque in (3.0, 3.0, 1.5, -2.0, 0.5, -3.0):
        states = task.transition(states, np.array([[torque]]), np.zeros((1, 4)))
        pendulum = steps(pendulum.heard([torque]), round(task.step_seconds / STEP))
        assert pendulum.velocity == pytest.approx(states[0, 1])
        assert pendulum.angle == pytest.approx(states[0, 0], abs=6 * 2 * 0.5 * 3.0 * 0.05**2)  # of Euler's steps


def test_the_motors_noise_equals_that_of_the_papers_task() -> None:
    ends = []
    for seed in range(200):
        robot = MotorPendulumRobot(MotorPendulumSettings(seed=seed))
        robot.state = MotorPendulum(is_driven=True, angle=0.0)
        for _ in range(500):
            robot.step()
        ends.append(robot.state.velocity)
    variance = 20 * (2 * Pendulum.noise_sd) ** 2  # of 20 half steps, 1 s in all
    assert pytest.approx(variance) == PAPER_NOISE**2
    assert abs(np.var(ends) / variance - 1.0) < 4 * math.sqrt(2 / 200)


LIMITS = MotorLimits(torque=2.0, torque_step=1.0, velocity=3.0)
BAD = {"malformed": [], "non_finite": [math.nan], "torque": [2.1], "torque_step": [1.1]}


@pytest.mark.parametrize(("kind", "command"), [*BAD.items(), ("malformed", [0.1, 0.1]), ("non_finite", [-math.inf])])
def test_a_bad_command_stops_the_motor_and_is_counted(kind: str, command: list[float]) -> None:
    moving = MotorPendulum(LIMITS, velocity=1.0, angle=0.0, is_driven=True)
    stopped = moving.heard(command)
    assert stopped.protection.counts == {**dict.fromkeys(KINDS, 0), kind: 1}
    assert stopped.protection.reason.startswith(f"{kind}: expected ")
    assert not stopped.is_driven
    assert steps(stopped, 100).velocity == 0.0


@given(st.lists(st.sampled_from(["malformed", "non_finite", "torque", "good", "reset"]), max_size=30))
def test_every_violation_is_counted_and_nothing_else(events: list[str]) -> None:
    pendulum, heard = MotorPendulum(), 0
    for event in events:
        if event == "reset":
            pendulum = pendulum.reset()
        else:
            pendulum = pendulum.heard({**BAD, "torque": [3.1], "good": [0.5]}[event]).stepped(STEP)
            heard += event == "good" and not pendulum.protection.is_stopped
            assert pendulum.is_driven == (not pendulum.protection.is_stopped)
    assert {kind: pendulum.protection.counts[kind] for kind in KINDS} == {kind: events.count(kind) for kind in KINDS}
    assert heard == 0 or pendulum.angle > -math.pi


@given(st.floats(0.0, 0.1), st.floats(0.0, 0.1), times)
def test_messages_arrive_in_order_within_their_time(latency: float, jitter: float, sent: list[float]) -> None:
    wire = Wire[int](stream(1, "wire", 0), latency, jitter, 0.0)
    for number, time in enumerate(sent):
        wire.send(time, number)
    assert wire.next_arrival >= latency
    arrived = list(wire.arrived(math.inf))
    assert [number for _, number in arrived] == list(range(len(sent)))
    assert all(a <= b for (a, _), (b, _) in pairwise(arrived))
    assert all(-1e-9 <= at - time - latency <= jitter + 1e-9 for (at, _), time in zip(arrived, sent, strict=True))
    assert wire.next_arrival == math.inf


def run(
    settings: MotorPendulumSettings, looks: list[float], end: float = 1.0
) -> tuple[list[tuple[float, JointReadings]], Hardware]:
    """Return all samples of a robot that is commanded now and then, looked at at those times and at the end."""
    hardware = Hardware(MotorPendulumRobot(settings))
    commands = [(0.1 * number, 0.5 * number) for number in range(5)]
    samples = []
    for time in sorted({*(t for t in looks if t < end), *(t for t, _ in commands), end}):
        samples += hardware.advance(time)
        for torque in (torque for at, torque in commands if at == time):
            hardware.send(time, [torque])
    return samples, hardware


@given(times)
def test_a_late_loop_catches_up_bit_identically(looks: list[float]) -> None:
    assert run(NOISY, looks)[0] == run(NOISY, [])[0]


def test_a_long_delay_is_caught_up_in_parts() -> None:
    hardware = Hardware(MotorPendulumRobot(NOISY))
    hardware.advance(3.5)
    assert hardware.time == MOST_CATCH_UP_S
    assert [hardware.advance(3.5) and hardware.time for _ in range(3)] == [2.0, 3.0, 3.5]


KINDS_OF = {"motor_pendulum": KINDS, "arm": drives.KINDS}


@pytest.mark.parametrize("robot", SETTINGS)
def test_the_page_documents_all_parameters_and_violations(robot: str) -> None:
    names = [*KINDS_OF[robot], *(entry.name for entry in entries(SETTINGS[robot]()))]
    assert [name for name in names if f"`{name}`" not in PAGE] == []


def test_the_examples_of_the_page_are_valid() -> None:
    examples = re.findall(r"```yaml\n(.*?)```", PAGE, flags=re.DOTALL)
    trees = [yaml.safe_load(example)["/**/simulated_robot"]["ros__parameters"] for example in examples]
    robots = [tree.pop("robot") for tree in trees]
    assert robots == ["motor_pendulum"]
    for robot, tree in zip(robots, trees, strict=True):
        assert settings_of(robot, tree) != SETTINGS[robot]()
