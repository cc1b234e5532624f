"""Checks of the sensed joint states: whether they are usable, recent, consistent, and follow the commands."""

from dataclasses import replace

import numpy as np

from rkhs_ros.rkhs.kernels import Array
from rkhs_ros.robot.gate_state import Gate, Mode, Rules
from rkhs_ros.robot.limits import EFFORT, MOST, POSITION, Limits, Sensed

CLOCK_TOLERANCE_S = 0.01  # a stamp may be ahead of this machine's clock by this much
IMPLIED = 20.0  # times its sensed speed at which a joint cannot have moved; a simulated robot may run at ten times
NOISE = 0.05  # rad or m by which the position of a joint may jump at any time
WITHIN_S = 1.0  # between a jump and one back, which contradict each other
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
    """Compare a sensed state with the previous one, and record a joint that jumps back after a jump.

    The positions of two publishers alternate, and jump each time. A single jump may be a reset of an encoder.
    """
    before = state.sensed
    if before is None:
        return state
    jump = _jump(rules.limits, before, news)
    if not jump.any():
        return state
    last = state.jump if state.jump is not None and now - state.jumped_at <= WITHIN_S else np.zeros_like(jump)
    reasons = [
        f"joint states contradict each other: the position of joint {joint} went from {before.position[joint]:g} "
        f"to {news.position[joint]:g} in {news.stamp - before.stamp:.3f} s, and the other way before; "
        "expected one publisher of the joints"
        for joint in np.flatnonzero(jump * last < 0.0)
    ]
    return replace(state, jump=jump, jumped_at=now, contradiction=next(iter(reasons), ""))


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
def _jump(limits: Limits, before: Sensed, after: Sensed) -> Array:
    """Return the direction in which each joint went further than it can, shape (joints,); 0 if it did not.

    Whole turns do not count.
    """
    seconds, change = after.stamp - before.stamp, after.position - before.position
    way = change - 2 * np.pi * np.round(change / (2 * np.pi))
    fastest = np.fmax(np.fmax(np.abs(before.velocity), np.abs(after.velocity)), 0.0)  # fmax ignores missing values
    if limits.kind != EFFORT:
        fastest = np.maximum(
            fastest, limits.velocity if limits.kind == POSITION else np.maximum(*np.abs(limits.bounds()))
        )
    return np.where(np.abs(way) > NOISE + IMPLIED * fastest * seconds, np.sign(way), 0.0)
