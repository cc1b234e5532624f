"""Joint states that contradict each other, and joints that holding drives instead of braking."""

import numpy as np
import pytest

from rkhs_ros.robot.gate import armed, begin, commanded, sensed, ticked
from rkhs_ros.robot.gate_state import Command, Gate, Mode
from rkhs_ros.robot.limits import EFFORT, KINDS, POSITION, Sensed
from test.unit.robot.gate_streams import PERIOD, World, rules_of

LIMIT = 3.0  # rad/s
RULES = rules_of(EFFORT, joints=1, sensed={"velocity": LIMIT})
FRICTION = 0.2  # 1/s


class Pendulum:
    """A pendulum of 1 kg m² that a gate commands by effort, with a second publisher of its joint states.

    Attributes:
        second: milliseconds between the messages of the second publisher, which are zeros; 0 for none.
        sign: of the motor's torque; -1 if its wires are swapped.
    """

    def __init__(self, sign: float = 1.0) -> None:
        self.gate: Gate = begin(RULES)
        self.angle, self.speed, self.effort = 1.0, 0.0, 0.0
        self.milliseconds, self.second, self.sign = 0, 0, sign
        self.track: list[tuple[Mode, float]] = []

    @property
    def now(self) -> float:
        return 100.0 + 1e-3 * self.milliseconds

    def run(self, milliseconds: int, torque: float | None = None) -> None:
        """Run with a stream of commands, or without."""
        for _ in range(milliseconds):
            self.milliseconds += 1
            self.speed += 1e-3 * (self.sign * self.effort - FRICTION * self.speed)
            self.angle += 1e-3 * self.speed
            if self.second and self.milliseconds % self.second == 0:
                self._sense(0.0, 0.0)
            if self.milliseconds % 10 == 3:
                self._sense(self.angle, self.speed)
            if torque is not None and self.milliseconds % 20 == 0:
                command = Command(1, self.milliseconds, self.now, np.array([torque]))
                self.gate, _ = commanded(self.gate, RULES, self.now, command)
            self.gate, output = ticked(self.gate, RULES, self.now)
            self.effort = self.effort if output is None else output[0]
            self.track.append((self.gate.mode, abs(self.speed)))

    def fastest(self, mode: Mode) -> float:
        return max((speed for each, speed in self.track if each == mode), default=0.0)

    def _sense(self, angle: float, speed: float) -> None:
        news = Sensed(self.now, np.array([angle]), np.array([speed]), np.zeros(1))
        self.gate, _ = sensed(self.gate, RULES, self.now, news)


@pytest.mark.parametrize(("second", "torque"), [(5, None), (10, 1.5), (23, -1.5)])
def test_a_second_publisher_of_joint_states_stops_an_effort_gate_and_does_not_drive_it(
    second: int, torque: float | None
) -> None:
    world = Pendulum()
    world.run(50)
    world.gate, reason = armed(world.gate, RULES, world.now)
    assert not reason
    world.run(500, torque)
    world.second = second
    world.run(5000, torque)
    assert world.fastest(Mode.STOPPED) <= LIMIT
    assert world.gate.mode == Mode.STOPPED
    assert world.gate.reason.startswith("joint states contradict each other: the position of joint 0 went from ")
    assert world.effort == 0.0
    assert "cannot arm: joint states contradict each other" in armed(world.gate, RULES, world.now)[1]
    world.second = 0
    world.run(1100)
    world.gate, reason = armed(world.gate, RULES, world.now)
    assert not reason
    world.run(3000)
    assert (world.gate.mode, round(world.speed, 3)) == (Mode.HOLDING, 0.0)


@pytest.mark.parametrize("moves", [False, True])
def test_a_joint_that_holding_accelerates_beyond_its_limit_is_released(moves: bool) -> None:
    world = Pendulum(sign=-1.0)
    world.run(50)
    world.gate, reason = armed(world.gate, RULES, world.now)
    assert not reason
    world.run(100, 1.0 if moves else None)
    world.speed += 0.1
    world.run(5000)
    assert world.gate.mode == Mode.STOPPED
    assert world.gate.releases
    assert world.effort == 0.0
    assert world.fastest(Mode.STOPPED) < 1.25 * LIMIT


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


def test_positions_that_alternate_prevent_arming() -> None:
    world = World(rules_of(POSITION))
    for position in (0.0, 0.7, 0.0):
        world.now += PERIOD
        world.sense(position=np.full(2, position))
    assert "cannot arm: joint states contradict each other: the position of joint 0 went from 0.7 to 0" in world.arm()
    world.now += 1.1
    world.sense()
    assert world.arm() == ""
