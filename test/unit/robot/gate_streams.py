"""Streams of valid and invalid commands to a gate, and a robot's protective check that is independent of the gate."""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from rkhs_ros.robot.gate import armed, begin, commanded, last_output, leave, sensed, stop_requested, stopped, ticked
from rkhs_ros.robot.gate_state import Command, CommandReport, Rules
from rkhs_ros.robot.limits import EFFORT, POSITION, VELOCITY, Limits, Sensed, SensedLimits

PERIOD = 0.01
NASTY = (np.nan, np.inf, -np.inf, 1e308, -1e308, 5e-324, 0.0, -0.0, 1e9, -1e9)
LIMITS: dict[str, dict[str, Any]] = {
    POSITION: {"minimum": -1.0, "maximum": 2.0, "velocity": 1.5, "acceleration": 8.0},
    VELOCITY: {"minimum": -1.0, "maximum": 2.0, "acceleration": 8.0},
    EFFORT: {"minimum": -3.0, "maximum": 3.0, "velocity": 100.0},
}


def rules_of(kind: str, joints: int = 2, sensed: dict[str, Any] | None = None, **limits: Any) -> Rules:
    """Return rules with equal limits for each joint, or with the given lists."""

    def each(name: str, given: dict[str, Any], none: float = np.inf) -> np.ndarray:
        return np.broadcast_to(np.asarray(given.get(name, none), dtype=float), joints).copy()

    commands, gain = LIMITS[kind] | limits, 1.0 if kind == EFFORT else 0.0
    return Rules(
        Limits(kind, *(each(name, commands) for name in ("minimum", "maximum", "velocity", "acceleration", "step"))),
        SensedLimits(
            each("minimum", sensed or {}, -np.inf), *(each(n, sensed or {}) for n in ("maximum", "velocity", "effort"))
        ),
        stiffness=np.full(joints, 20.0 * gain),
        damping=np.full(joints, 5.0 * gain),
        command_timeout=0.2,
        stale_after=0.1,
        period=PERIOD,
        rest_speed=0.02,
        rest_time=0.2,
    )


@dataclass
class Protection:
    """Records the first violation that would trigger a robot's protective stop, from commands one period apart.

    ``slack`` allows for rounding, relative to the size of the numbers and divided by the period.
    """

    limits: Limits
    last: np.ndarray
    velocity: np.ndarray = field(init=False)
    trips: list[tuple[str, np.ndarray]] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.velocity = np.zeros_like(self.last)

    @np.errstate(over="ignore")
    def take(self, value: np.ndarray) -> None:
        if self.trips:
            return
        if not np.isfinite(value).all():
            self.trips.append(("not finite", value))
            return
        velocity = (value - self.last) / PERIOD
        slack = 1e-12 * (1.0 + np.abs(value) + np.abs(self.last))
        checks = {
            "range": (value, self.limits.minimum, self.limits.maximum, 0.0),
            "step": (value - self.last, -self.limits.step, self.limits.step, slack),
        }
        if self.limits.kind == VELOCITY:
            checks["velocity"] = (value, -self.limits.velocity, self.limits.velocity, 0.0)
            checks["acceleration"] = (velocity, -self.limits.acceleration, self.limits.acceleration, slack / PERIOD)
        else:
            checks["velocity"] = (velocity, -self.limits.velocity, self.limits.velocity, slack / PERIOD)
        if self.limits.kind == POSITION:
            change, most = (velocity - self.velocity) / PERIOD, self.limits.acceleration
            checks["acceleration"] = (change, -most, most, 4 * slack / PERIOD**2)
        for name, (number, low, high, more) in checks.items():
            if ((number < low - more) | (number > high + more)).any():
                self.trips.append((name, value))
        self.last, self.velocity = value, velocity


class World:
    """A gate, the robot that executes its outputs, and their clock."""

    def __init__(self, rules: Rules, start: Any = 0.0) -> None:
        joints = rules.limits.joints
        self.rules, self.now, self.state = rules, 100.0, begin(rules)
        self.position = np.broadcast_to(np.asarray(start, dtype=float), joints).copy()
        self.velocity = np.zeros(joints)
        self.effort = np.zeros(joints)
        self.senses, self.load, self.sign = True, 0.0, 1.0  # the sign is that of the motors' torques
        self.numbers = {1: 0, 2: 0}
        self.outputs: list[np.ndarray] = []
        self.times: list[float] = []
        at_rest = self.position if rules.limits.kind == POSITION else np.zeros(joints)
        self.protection, self.bare = Protection(rules.limits, at_rest), Protection(rules.limits, at_rest)
        self.sense()

    def sense(self, **changes: Any) -> str:
        values = {"stamp": self.now, "position": self.position, "velocity": self.velocity, "effort": self.effort}
        self.state, reason = sensed(self.state, self.rules, self.now, Sensed(**(values | changes)))
        return reason

    def tick(self, late: float = 0.0) -> None:
        """Advance by a period plus the gate's lateness."""
        self.now += PERIOD + late
        self._obey(PERIOD + late)
        if self.senses:
            self.sense()
        self.state, output = ticked(self.state, self.rules, self.now)
        if output is not None:
            self.outputs.append(output)
            self.times.append(self.now)
            self.protection.take(output)

    def wait(self, seconds: float) -> None:
        for _ in range(round(seconds / PERIOD)):
            self.tick()

    def command(self, values: Any, instance: int = 1, age: float = 0.0, number: int | None = None) -> CommandReport:
        """Send a command to the gate, and to the bare protection without a gate."""
        number = self.numbers.get(instance, 0) + 1 if number is None else number
        self.numbers[instance] = max(self.numbers.get(instance, 0), number)
        array = None if values is None else np.asarray(values, dtype=float)
        command = Command(instance, number, self.now - age, array)
        self.state, report = commanded(self.state, self.rules, self.now, command)
        if array is not None and array.shape == self.protection.last.shape:
            self.bare.take(array)
        return report

    def arm(self) -> str:
        self.state, reason = armed(self.state, self.rules, self.now)
        return reason

    def stop(self, reason: str = "requested") -> None:
        self.state = stopped(self.state, reason)

    def leave(self, timeout: float = 3.0) -> float:
        """Shut the gate down as its process does; return the seconds that it takes."""
        begun, is_left = self.now, False
        while not is_left and self.now < begun + timeout:
            self.state, is_left = leave(self.state, self.rules, self.now)
            if not is_left:
                self.tick()
        if (last := last_output(self.state, self.rules)) is not None:
            self.outputs.append(last.value)
        return self.now - begun

    def coast(self, seconds: float) -> None:
        """Advance without the gate; the robot keeps the last command."""
        for _ in range(round(seconds / PERIOD)):
            self._obey(PERIOD)

    def request_stop(self, is_requested: bool) -> None:
        self.state = stop_requested(self.state, "a stop is requested" if is_requested else "")

    def moves(self) -> bool:
        return len(self.outputs) > 1 and not np.array_equal(self.outputs[-1], self.outputs[-2])

    def _obey(self, seconds: float) -> None:
        if not self.outputs:
            return
        newest = self.outputs[-1]
        if self.rules.limits.kind == POSITION:
            self.velocity, self.position = (newest - self.position) / seconds, newest
            return
        change = (
            (self.sign * newest - self.load) * seconds if self.rules.limits.kind == EFFORT else newest - self.velocity
        )
        self.velocity = self.velocity + change
        self.position = self.position + self.velocity * seconds


def play(rules: Rules, stream: np.random.Generator, events: int = 24) -> World:
    """Send a gate a random stream of valid and invalid events."""
    world = World(rules, start=rules.limits.minimum if stream.random() < 0.3 else 0.0)
    if stream.random() < 0.7:
        world.arm()
    for _ in range(events):
        _EVENTS[stream.choice(len(_EVENTS), p=_ODDS)](world, stream, rules.limits.joints)
        for _ in range(stream.integers(0, 7)):
            world.tick(late=stream.choice([0.0, 0.0, 0.0, 0.003, 0.05]))
    return world


def _good(world: World, stream: np.random.Generator, joints: int) -> None:
    world.command(stream.uniform(-3, 3, joints), age=stream.uniform(0, 0.1))


def _burst(world: World, stream: np.random.Generator, joints: int) -> None:
    for _ in range(stream.integers(2, 20)):
        _good(world, stream, joints)


def _blind(world: World, stream: np.random.Generator, joints: int) -> None:
    world.senses = bool(stream.integers(2))


def _bad_sense(world: World, stream: np.random.Generator, joints: int) -> None:
    name = stream.choice(["stamp", "position", "velocity", "effort"])
    world.sense(**{name: stream.choice(NASTY) if name == "stamp" else stream.choice(NASTY, joints)})


STALE = (-1e9, -0.1, 0.21, 1e9, np.nan, np.inf)  # ages of commands
_LIKELY: tuple[tuple[int, Callable[[World, np.random.Generator, int], object]], ...] = (
    (14, _good),
    (3, lambda world, stream, joints: world.command(stream.choice([*NASTY, *stream.uniform(-2, 2, 5)], joints))),
    (1, lambda world, stream, joints: world.command(stream.uniform(-1, 1, stream.integers(0, 6)))),
    (2, _burst),
    (1, lambda world, stream, joints: world.command(np.full(joints, 9.0), age=stream.choice(STALE))),
    (1, lambda world, stream, joints: world.command(stream.uniform(-9, 9, joints), instance=2)),
    (1, lambda world, stream, joints: world.command(np.ones(joints), number=stream.integers(0, world.numbers[1] + 1))),
    (1, lambda world, stream, joints: world.wait(stream.uniform(0.0, 0.3))),
    (1, lambda world, stream, joints: world.command(None, instance=stream.integers(1, 3))),
    (1, lambda world, stream, joints: world.stop()),
    (1, lambda world, stream, joints: world.request_stop(bool(stream.integers(2)))),
    (7, lambda world, stream, joints: world.arm()),
    (1, _blind),
    (1, _bad_sense),
)
_EVENTS = [event for _, event in _LIKELY]
_ODDS = np.array([odds for odds, _ in _LIKELY]) / 36
