"""Checks of the sensed joint states: whether they are usable, recent, consistent, and follow the commands."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from rkhs_ros.rkhs.kernels import Array
from rkhs_ros.robot.gate_state import Gate, Mode, Rules
from rkhs_ros.robot.limits import EFFORT, MOST, POSITION, Limits, Sensed

CLOCK_TOLERANCE_S = 0.01  # a stamp may be ahead of this machine's clock by this much
IMPLIED = 5.0  # times its greatest plausible speed at which a joint cannot have moved
NOISE = 0.05  # rad or m by which the position of a joint may jump at any time
WITHIN_S = 1.0  # between two jumps that contradict each other; one may be a reset of an encoder
SETTLING_S = 0.2  # after a stop, in which the speed of a joint that holds by effort may still grow


def flaw(state: Gate, rules: Rules, now: float, news: Sensed) -> str:
    """Return why a sensed state cannot be used; empty if it can."""
    age = now - news.stamp
    if not -CLOCK_TOLERANCE_S <= age <= rules.stale_after:
        return f"joint state: expected a stamp within the last {rules.stale_after:g} s, got an age of {age:.3f} s"
    if state.sensed is not None and news.stamp < state.sensed.stamp:
        return "joint state: expected a stamp no earlier than that of the previous message, got an earlier one"
    for name in rules.fields:
        if not (np.abs(getattr(news, name)) <= MOST).all():
            return f"joint state: expected the {name} of every joint within {MOST:g}, got {getattr(news, name)}"
    return ""


def stale(state: Gate, rules: Rules, now: float) -> str:
    """Return an error message if the sensed state is missing or stale; empty otherwise, or if no sensor is needed."""
    if rules.stale_after == np.inf:
        return ""
    if state.sensed is None:
        return "no usable joint state has been received"
    is_stale = now - state.sensed.stamp > rules.stale_after
    return f"no usable joint state for {rules.stale_after:g} s" if is_stale else ""


def compared(state: Gate, rules: Rules, now: float, news: Sensed) -> Gate:
    """Compare a sensed state with the previous one, and record two jumps of a joint within a short time.

    The positions of two publishers alternate, and jump each time.
    """
    jump = _jump(rules.limits, state.sensed, news) if state.sensed is not None else ""
    if not jump:
        return state
    is_second = now - state.jumped_at <= WITHIN_S
    reason = f"joint states contradict each other: {jump}; expected one publisher of the joints"
    return replace(state, jumped_at=now, contradiction=reason if is_second else "")


def contradiction(state: Gate, now: float) -> str:
    """Return why the latest sensed states contradict each other; empty if they do not."""
    return state.contradiction if now - state.jumped_at <= WITHIN_S else ""


def runaway(state: Gate, rules: Rules, now: float, news: Sensed) -> Gate:
    """Release a stopped robot whose speed grows beyond its limit: holding by effort drives it instead of braking it."""
    if state.mode != Mode.STOPPED or rules.limits.kind != EFFORT:
        return state
    state = replace(state, stopped_at=min(state.stopped_at, now))
    speed = np.abs(news.velocity)
    if now - state.stopped_at <= SETTLING_S:
        return replace(state, top_speed=speed if state.top_speed is None else np.maximum(state.top_speed, speed))
    top = rules.sensed.velocity if state.top_speed is None else np.maximum(rules.sensed.velocity, state.top_speed)
    return replace(state, releases=state.releases or bool((speed > top).any()))


@np.errstate(over="ignore", invalid="ignore")  # values that the gate does not need may be anything
def _jump(limits: Limits, before: Sensed, after: Sensed) -> str:
    """Return which joint cannot have moved to its position; empty if all can. Whole turns do not count."""
    seconds, change = after.stamp - before.stamp, after.position - before.position
    way = np.abs(change - 2 * np.pi * np.round(change / (2 * np.pi)))
    fastest = np.fmax(np.nan_to_num(np.abs(before.velocity)), np.nan_to_num(np.abs(after.velocity)))
    if limits.kind != EFFORT:
        fastest = np.maximum(fastest, _commanded_speed(limits))
    joints = np.flatnonzero(way > NOISE + IMPLIED * fastest * seconds)
    if not joints.size:
        return ""
    joint = joints[0]
    ends = f"from {before.position[joint]:g} to {after.position[joint]:g}"
    return f"the position of joint {joint} went {ends} in {seconds:.3f} s at a speed of {fastest[joint]:g} per second"


def _commanded_speed(limits: Limits) -> Array:
    """Return the greatest speed that commands of positions or velocities may cause, shape (joints,)."""
    return limits.velocity if limits.kind == POSITION else np.maximum(*np.abs(limits.bounds()))
