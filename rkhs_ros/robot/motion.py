"""Rate-limited motion of commands towards a goal.

Velocity and effort commands move straight to their goal at the greatest allowed rate. Position commands have a
velocity whose change is limited by the acceleration, and from which the joint can always stop within its range.
"""

import math
from dataclasses import dataclass

import numpy as np

from rkhs_ros.rkhs.kernels import Array
from rkhs_ros.robot.limits import POSITION, Limits

TINY = 1e-12  # relative difference, and velocities of one period, below which only rounding is left


@dataclass(frozen=True, eq=False)
class Setpoint:
    """The newest command and its rate of change.

    Attributes:
        value: the command, shape (joints,).
        rate: velocity of position commands, per second, shape (joints,); 0 for other commands.
    """

    value: Array
    rate: Array


def rest_at(value: Array) -> Setpoint:
    """Return a command that does not change."""
    return Setpoint(value, np.zeros_like(value))


def advance(limits: Limits, period: float, motion: Setpoint, goal: Array | None) -> Setpoint:
    """Return the next command towards a goal.

    Args:
        limits: of the commands.
        period: seconds between commands.
        motion: the previous command.
        goal: the desired command, shape (joints,); None to come to rest: positions brake, other commands go to 0.
    """
    if limits.kind == POSITION:
        return _accelerate(limits, period, motion, goal)
    low, high = limits.bounds()
    most = np.minimum(limits.rate * period, limits.step)
    change = (np.zeros_like(motion.value) if goal is None else goal) - motion.value
    return rest_at(np.clip(motion.value + np.clip(change, -most, most), low, high))


def foreseen(limits: Limits, period: float, motion: Setpoint, goal: Array, periods: int) -> Array:
    """Return the command after many periods, equal to that of `advance` up to rounding, in few steps.

    Args:
        limits: of the commands.
        period: seconds between commands.
        motion: the newest command.
        goal: the desired command, shape (joints,).
        periods: their number, at least 1.
    """
    if limits.kind != POSITION:
        most = periods * np.minimum(limits.rate * period, limits.step)
        return np.clip(motion.value + np.clip(goal - motion.value, -most, most), *limits.bounds())
    top = np.minimum(limits.velocity, limits.step / period)
    change = limits.acceleration * period
    ways = (np.clip(goal, limits.minimum, limits.maximum) - motion.value) / period
    joints = zip(ways.tolist(), motion.rate.tolist(), top.tolist(), change.tolist(), strict=True)
    left = np.array([_way_left(way, rate, most, gain, periods) for way, rate, most, gain in joints])
    return np.asarray(np.clip(motion.value + (ways - left) * period, limits.minimum, limits.maximum))


def braking(limits: Limits, period: float, motion: Setpoint, most: int) -> list[tuple[float, Array]]:
    """Return the braking trajectory of position commands, equal to that of `advance` without a goal.

    Args:
        limits: of the commands.
        period: seconds between commands.
        motion: the newest command.
        most: greatest number of points, 2 or more.

    Returns:
        Pairs of the time from now, in seconds, and the positions, shape (joints,). The first is now; in the last all
        joints are at rest.
    """
    change = limits.acceleration * period
    speed = np.abs(motion.rate)
    periods = np.floor(np.divide(speed, change, out=np.zeros_like(speed), where=change > 0.0))
    knots = np.unique(np.linspace(0.0, periods.max(), most).round())
    moving = np.minimum(knots[:, None], periods)  # (knots, joints): for how many periods by then
    way = period * (moving * speed - change * moving * (moving + 1.0) / 2.0)
    values = np.clip(motion.value + np.sign(motion.rate) * way, limits.minimum, limits.maximum)
    return list(zip((knots * period).tolist(), values, strict=True))


def _accelerate(limits: Limits, period: float, motion: Setpoint, goal: Array | None) -> Setpoint:
    """Return the next positions, using the velocity nearest to the desired one that respects all limits.

    The desired velocity lets the joint come to rest before its goal; the actual one is at most that, or brakes with the
    full acceleration. As goals lie within the range, the joint can always come to rest within its range.
    """
    top = np.minimum(limits.velocity, limits.step / period)
    change = limits.acceleration * period
    wanted = np.zeros_like(motion.rate)
    if goal is not None:
        way = np.clip(goal, limits.minimum, limits.maximum) - motion.value
        wanted = np.sign(way) * np.minimum(top, _stoppable(np.abs(way), change, period))
    rate = np.clip(wanted, motion.rate - change, motion.rate + change)
    return Setpoint(np.clip(motion.value + rate * period, limits.minimum, limits.maximum), rate)


def _way_left(way: float, rate: float, top: float, change: float, periods: int) -> float:
    """Return the way of a joint to its goal after many periods of `_accelerate`, in velocities of one period.

    Each phase of the motion (speeding up, at the greatest velocity, slowing down) changes the velocity uniformly, so
    all its periods but the last ones are taken at once. Each pass of the loop takes one period, and then a phase.
    """
    if not (top and change):  # it never moves
        return way
    while periods and (abs(way) > TINY or abs(rate) > change):
        wanted = math.copysign(min(top, _stoppable_velocity(abs(way), change)), way)
        before, rate = rate, min(max(wanted, rate - change), rate + change)
        way, periods = way - rate, periods - 1
        sign = math.copysign(1.0, way)
        more = sign * (rate - before)  # positive if the joint gains speed towards its goal
        if not 0.0 < abs(more) < (1.0 - TINY) * change:  # a uniform phase
            uniform = min(_uniform_periods(abs(way), sign * rate, more, top, change), periods)
            way -= uniform * rate + sign * more * uniform * (uniform + 1) / 2.0
            rate, periods = rate + sign * more * uniform, periods - uniform
    return way if periods == 0 else 0.0


def _uniform_periods(way: float, speed: float, more: float, top: float, change: float) -> int:
    """Return for how many periods the speed towards a goal certainly keeps changing by `more` in each.

    A joint at speed v needs at most ``v (v + change) / (2 change) + change / 8`` to come to rest.
    """
    if more > 0.0:
        # After k periods, the next speed is v = speed + (k + 1) change, and its way to rest must be left.
        first = speed + change
        needed = first * (first + change) / (2.0 * change) + change / 8.0
        root = first * first + change * (way - needed)
        to_rest = (math.sqrt(root) - first) / change if root > 0.0 else 0.0
        return max(math.floor(min(to_rest, (top - speed) / change - 1.0)), 0)
    if more < 0.0:
        return max(math.floor(speed / change) - 1, 0)
    needed = speed * (speed + change) / (2.0 * change) + change / 8.0
    return max(math.floor((way - needed) / speed), 0) if speed > 0.0 else 0


def _stoppable_velocity(steps: float, change: float) -> float:
    """Return `_stoppable` of one joint, of a distance in velocities of one period and with a change above 0."""
    n = math.floor((math.sqrt(1.0 + 8.0 * steps / change) - 1.0) / 2.0)
    return (steps + change * n * (n + 1.0) / 2.0) / (n + 1.0)


def _stoppable(distance: Array, change: Array, period: float) -> Array:
    """Return the greatest velocity at which a joint can still come to rest within a distance.

    At velocity v it moves by v in this period, by v - change in the next, and so on, (n + 1) v - change n (n + 1) / 2
    periods in all, n the whole number of changes in v.
    """
    steps = distance / period  # the distance, in velocities of one period
    with np.errstate(divide="ignore", invalid="ignore"):
        n = np.floor((np.sqrt(1.0 + 8.0 * steps / change) - 1.0) / 2.0)
        velocity = (steps + change * n * (n + 1.0) / 2.0) / (n + 1.0)
    return np.where(change > 0.0, velocity, 0.0)
