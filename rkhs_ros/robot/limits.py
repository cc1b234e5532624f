"""Limits of commands and of sensed joint states, validated on construction, and motion towards a goal within them.

Velocity and effort commands move straight to their goal at the greatest allowed rate. Position commands have a
velocity whose change is limited by the acceleration, and from which the joint can always stop within its range.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from rkhs_ros.base.validation import require
from rkhs_ros.rkhs.kernels import Array

POSITION, VELOCITY, EFFORT = "position", "velocity", "effort"
KINDS = (POSITION, VELOCITY, EFFORT)
LIMITS = ("minimum", "maximum", "velocity", "acceleration", "step")  # of commands
SENSED_LIMITS = ("minimum", "maximum", "velocity", "effort")
LEAST, MOST = 1e-9, 1e9  # smallest and largest magnitude of a nonzero limit, so that arithmetic stays accurate
MOST_POINTS = 10  # of a braking trajectory, which is sent in every period
UNITS = {POSITION: "rad or m", VELOCITY: "rad/s or m/s", EFFORT: "N m or N"}


@dataclass(frozen=True, eq=False)
class Limits:
    """Limits of the commands to joints; ValueError is raised if they are missing, contradictory, negative or too large.

    Each is an array of shape (joints,). Infinity means no limit; 0 is a limit.

    Attributes:
        kind: of the commands: 'position', 'velocity' or 'effort'.
        minimum: least command; for velocities and efforts at most 0, so that rest is allowed.
        maximum: greatest command; for velocities and efforts at least 0.
        velocity: for positions and efforts the greatest change per second; for velocities the greatest magnitude.
        acceleration: for positions the greatest change of their velocity per second; for velocities the greatest change
            per second; none for efforts.
        step: greatest difference of successive commands, however much time has passed.
    """

    kind: str
    minimum: Array
    maximum: Array
    velocity: Array
    acceleration: Array
    step: Array

    def __post_init__(self) -> None:
        for name in ("velocity", "acceleration", "step"):
            values = getattr(self, name)
            good = (values == 0) | ((values >= LEAST) & (values <= MOST)) | (values == np.inf)
            require(bool(good.all()), f"limits.{name}", f"0, or from {LEAST:g} to {MOST:g}", values)
        needed = {POSITION: ("velocity", "acceleration"), VELOCITY: ("acceleration",), EFFORT: ()}[self.kind]
        for name in ("minimum", "maximum", *needed):
            finite = bool(np.isfinite(getattr(self, name)).all())
            require(finite, f"limits.{name}", f"a limit for each joint (required for {self.kind} commands)", "none")
        got = f"{self.minimum} and {self.maximum}"
        require(bool((self.minimum <= self.maximum).all()), "limits", "minimum <= maximum", got)
        rests = self.kind == POSITION or bool((self.minimum <= 0).all() and (self.maximum >= 0).all())
        require(rests, "limits", "minimum <= 0 <= maximum, so that rest is allowed", got)
        none = self.kind != EFFORT or bool(np.isinf(self.acceleration).all())
        require(none, "limits.acceleration", "no value for effort commands", self.acceleration)

    @property
    def joints(self) -> int:
        """Number of joints."""
        return self.minimum.size

    @property
    def rate(self) -> Array:
        """The greatest change of a command per second, shape (joints,)."""
        return self.acceleration if self.kind == VELOCITY else self.velocity

    def bounds(self) -> tuple[Array, Array]:
        """Return the least and the greatest command, each of shape (joints,)."""
        if self.kind != VELOCITY:
            return self.minimum, self.maximum
        return np.maximum(self.minimum, -self.velocity), np.minimum(self.maximum, self.velocity)


@dataclass(frozen=True, eq=False)
class Sensed:
    """A sensed joint state: its time, in seconds of the gate's clock, and positions, velocities and efforts.

    Each is an array of shape (joints,), in rad or m, rad/s or m/s, N m or N; nan where a value is missing.
    """

    stamp: float
    position: Array
    velocity: Array
    effort: Array


@dataclass(frozen=True, eq=False)
class SensedLimits:
    """Limits of the sensed joint states, each an array of shape (joints,); infinity means no limit.

    Attributes:
        minimum: least position.
        maximum: greatest position.
        velocity: greatest magnitude of the velocity.
        effort: greatest magnitude of the effort.
    """

    minimum: Array
    maximum: Array
    velocity: Array
    effort: Array

    def __post_init__(self) -> None:
        good = bool((self.minimum <= self.maximum).all())
        require(good, "sensed", "minimum <= maximum", f"{self.minimum} and {self.maximum}")

    @cached_property
    def _ranges(self) -> dict[str, tuple[Array, Array]]:
        bounds = {POSITION: (self.minimum, self.maximum)}
        return bounds | {VELOCITY: (-self.velocity, self.velocity), EFFORT: (-self.effort, self.effort)}

    @cached_property
    def fields(self) -> set[str]:
        """Quantities that must be sensed to check these limits."""
        return {name for name, bounds in self._ranges.items() if np.isfinite(bounds).any()}

    def exceeded(self, sensed: Sensed) -> Iterator[str]:
        """Yield a message for each limit that is exceeded; missing values exceed none."""
        for name, (low, high) in self._ranges.items():
            values = getattr(sensed, name)
            for joint in np.flatnonzero((values < low) | (values > high)):
                limits = f"from {low[joint]:g} to {high[joint]:g}"
                yield f"{name} of joint {joint}: expected {limits} {UNITS[name]}, got {values[joint]:g}"


@dataclass(frozen=True, eq=False)
class Setpoint:
    """The newest command, shape (joints,), and its rate of change per second, which is 0 unless it is a position."""

    value: Array
    rate: Array


def rest_at(value: Array) -> Setpoint:
    """Return a command that does not change."""
    return Setpoint(value, np.zeros_like(value))


def advance(limits: Limits, period: float, motion: Setpoint, goal: Array | None, periods: int = 1) -> Setpoint:
    """Return the command some periods after ``motion``, the previous one, when moving towards a goal.

    The goal has the shape (joints,); None means to come to rest: positions brake, other commands go to 0.
    """
    if limits.kind == POSITION:
        top = np.minimum(limits.velocity, limits.step / period) if goal is not None else np.zeros_like(motion.value)
        goal = np.clip(motion.value if goal is None else goal, limits.minimum, limits.maximum)
        arrays = (motion.value, motion.rate, goal, top, limits.acceleration * period, limits.minimum, limits.maximum)
        joints = zip(*(each.tolist() for each in arrays), strict=True)
        value, rate = np.array([_accelerate(period, periods, joint) for joint in joints]).T
        return Setpoint(value, rate)
    most = periods * np.minimum(limits.rate * period, limits.step)
    change = (np.zeros_like(motion.value) if goal is None else goal) - motion.value
    return rest_at(np.clip(motion.value + np.clip(change, -most, most), *limits.bounds()))


def braking(limits: Limits, period: float, motion: Setpoint) -> list[tuple[float, Array]]:
    """Return the braking trajectory of position commands, equal to that of ``advance`` without a goal.

    Returns:
        At most 10 pairs of the time from now, in seconds, and the positions, shape (joints,). The first is now;
        in the last one, all joints are at rest.
    """
    change = limits.acceleration * period
    speed = np.abs(motion.rate)
    periods = np.floor(np.divide(speed, change, out=np.zeros_like(speed), where=change > 0.0))
    knots = np.unique(np.linspace(0.0, periods.max(), MOST_POINTS).round())
    moving = np.minimum(knots[:, None], periods)  # (knots, joints): for how many periods by then
    way = period * (moving * speed - change * moving * (moving + 1.0) / 2.0)
    values = np.clip(motion.value + np.sign(motion.rate) * way, limits.minimum, limits.maximum)
    return list(zip((knots * period).tolist(), values, strict=True))


def _accelerate(period: float, periods: int, joint: Sequence[float]) -> tuple[float, float]:
    """Return the position and the velocity of a joint after some periods.

    In each, the velocity changes by at most ``change``, to the one nearest to that from which the joint can come to
    rest before its goal, at most ``top``. As goals lie within the range, the joint can always come to rest within it.
    """
    value, rate, goal, top, change, low, high = joint
    for _ in range(periods):
        way = goal - value
        if way == rate == 0.0:
            break
        wanted = math.copysign(min(top, _stoppable(abs(way) / period, change)), way)
        rate = min(max(wanted, rate - change), rate + change)
        value = min(max(value + rate * period, low), high)
    return value, rate


def _stoppable(steps: float, change: float) -> float:
    """Return the greatest velocity at which a joint can still come to rest within a distance.

    At velocity v it moves by v in this period, by v - change in the next, and so on, (n + 1) v - change n (n + 1) / 2
    periods in all, n the whole number of changes in v. The distance is in velocities of one period.
    """
    if not change:
        return 0.0
    n = math.floor((math.sqrt(1.0 + 8.0 * steps / change) - 1.0) / 2.0)
    return (steps + change * n * (n + 1.0) / 2.0) / (n + 1.0)
