"""Joint states that contradict each other, and joints that holding drives instead of braking."""

import numpy as np
import pytest

from rkhs_ros.robot.gate_state import Mode
from rkhs_ros.robot.limits import EFFORT, KINDS
from test.unit.robot.gate_streams import PERIOD, World, rules_of

LIMIT = 3.0  # rad/s


def armed_pendulum() -> World:
    world = World(rules_of(EFFORT, joints=1, sensed={"velocity": LIMIT}), start=1.0)
    world.wait(0.05)
    assert world.arm() == ""
    return world


def run(world: World, seconds: float, torque: float | None = None, *, second: bool = False) -> float:
    """Run with a stream of commands, or without, perhaps with a second publisher of joint states, which are zeros.

    Return the greatest speed while the gate was stopped.
    """
    fastest = 0.0
    for _ in range(round(seconds / PERIOD)):
        if torque is not None:
            world.command([torque])
        if second:
            world.sense(position=np.zeros(1), velocity=np.zeros(1))
        world.tick()
        if world.state.mode == Mode.STOPPED:
            fastest = max(fastest, float(abs(world.velocity[0])))
    return fastest


@pytest.mark.parametrize("torque", [None, 1.5, -1.5])
def test_a_second_publisher_of_joint_states_stops_an_effort_gate_and_does_not_drive_it(torque: float | None) -> None:
    world = armed_pendulum()
    run(world, 0.5, torque)
    assert run(world, 5.0, torque, second=True) <= LIMIT
    assert world.state.mode == Mode.STOPPED
    assert world.state.reason.startswith("joint states contradict each other: the position of joint 0 went from ")
    assert world.outputs[-1] == 0.0
    assert "cannot arm: joint states contradict each other" in world.arm()
    world.velocity[:] = 0.0  # by friction
    run(world, 1.1)
    assert world.arm() == ""
    run(world, 3.0)
    assert (world.state.mode, round(float(world.velocity[0]), 3)) == (Mode.HOLDING, 0.0)


@pytest.mark.parametrize("torque", [None, 1.0])
def test_a_joint_that_holding_accelerates_beyond_its_limit_is_released(torque: float | None) -> None:
    world = armed_pendulum()
    world.sign = -1.0  # the wires of the motor are swapped
    run(world, 0.1, torque)
    world.velocity += 0.1
    assert run(world, 5.0) < 1.25 * LIMIT
    assert (world.state.mode, world.state.releases) == (Mode.STOPPED, True)
    assert world.outputs[-1] == 0.0
    world.sign, world.velocity[:] = 1.0, 0.0
    world.position += 0.9  # it falls, and its wires are mended
    world.tick()
    assert world.arm() == ""
    world.tick()
    assert world.outputs[-1] == pytest.approx(0.0, abs=1e-6)  # it is held where it is


@pytest.mark.parametrize("kind", KINDS)
def test_one_jump_whole_turns_gaps_and_noise_are_no_contradictions(kind: str) -> None:
    world = World(rules_of(kind))
    assert world.arm() == ""
    home = world.position
    for jump in (0.5, 0.5 + 2 * np.pi, 0.54, 0.5, 0.5 - 2 * np.pi):
        world.sense(position=home + jump)
        world.now += PERIOD
    assert world.state.mode == Mode.HOLDING
    world.now += 0.05
    world.sense(position=home + 0.5 + 20 * 0.05 * 2.0, velocity=np.full(2, 2.0))
    assert world.state.mode == Mode.HOLDING
    world.now += PERIOD
    world.sense(position=home + 0.5)
    assert world.state.mode == Mode.STOPPED
    assert world.state.releases == (kind == EFFORT)
