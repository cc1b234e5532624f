"""Rate-limited motion of commands towards a goal.

Velocity and effort commands move straight to their goal at the greatest allowed rate. Position commands have a
velocity whose change is limited by the acceleration, and from which the joint can always stop within its range.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from rkhs_ros.rkhs.kernels import Array
from rkhs_ros.robot.limits import POSITION, Limits


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


def advance(limits: Limits, period: float, motion: Setpoint, goal: Array | None, periods: int = 1) -> Setpoint:
    """Return the command after some periods of a motion towards a goal.

    Args:
        limits: of the commands.
        period: seconds between commands.
        motion: the previous command.
        goal: the desired command, shape (joints,); None to come to rest: positions brake, other commands go to 0.
        periods: their number.
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
