"""The gate between whoever commands a robot and its hardware, as functions of values.

A gate is a `Gate`, which every command, every sensed state and every tick of its clock turn into the next one. It is
asked for an output at each tick; between ticks nothing is sent. All times are seconds of one clock that never goes
back, the stamps of messages among them.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from rkhs_ros.rkhs.kernels import Array
from rkhs_ros.robot.gate_state import CLAMPED, MOST_NUMBER, Command, CommandReport, Flags, Gate, Mode, Rules
from rkhs_ros.robot.limits import EFFORT, MOST, POSITION, VELOCITY, Limits, Sensed
from rkhs_ros.robot.motion import Setpoint, advance, rest_at

CLOCK_TOLERANCE_S = 0.01  # by which a stamp may be ahead of this machine's clock
SAME = 1e-9  # relative difference of commands that are taken to be the same


def begin(rules: Rules) -> Gate:
    """Return the state of a gate that has just begun: disarmed."""
    return Gate(motion=None if rules.limits.kind == POSITION else rest_at(np.zeros(rules.limits.joints)))


def commanded(state: Gate, rules: Rules, now: float, command: Command) -> tuple[Gate, CommandReport]:
    """Take a command, or refuse it; return what becomes of it."""
    state, motion = _count(state, commands=1), state.motion
    reason = _objection(state, rules, now, command)
    if motion is None or reason:
        newest = motion.value if motion else np.zeros(0)
        refusal = reason or "expected positions to be sensed before a command, got none"
        return _count(state, refusals=1), CommandReport(newest, Flags.REFUSED, refusal)
    interval = now - state.heard_at if state.goal is not None else np.inf
    state = replace(state, heard_at=now, sender=command.instance, number=command.number)
    if command.values is None:
        return _held(state), CommandReport(np.zeros(0))
    if state.mode == Mode.STOPPED:
        return state, CommandReport(motion.value, Flags.NOT_ARMED)
    goal, flags = _clamp(rules.limits, motion.value, command.values)
    executed, more = _foresee(rules, motion, goal, interval)
    flags |= more if state.is_armed else more | Flags.NOT_ARMED
    state = replace(state, mode=Mode.MOVING if state.is_armed else state.mode, goal=goal)
    return _count(state, clamps=bool(flags & CLAMPED)), CommandReport(executed, flags)


def sensed(state: Gate, rules: Rules, now: float, news: Sensed) -> tuple[Gate, str]:
    """Take what was sensed, and stop where it passes a limit; return why it was refused, or nothing.

    What is refused leaves what was sensed before to grow old.
    """
    reason = _flaw(state, rules, now, news)
    if reason:
        return _count(state, refusals=1), reason
    state = _timed_rest(_anchored(replace(state, sensed=news)), rules, now)
    passed = next(rules.sensed.passed(news), "")
    return stopped(state, passed) if passed else state, ""


def ticked(state: Gate, rules: Rules, now: float) -> tuple[Gate, Array | None]:
    """Move on by a period where one has passed since the tick before; return what is to be sent.

    A late tick is not made up for by a short one: outputs are a period apart or more, so what changes by no more than
    a limit allows within a period never changes faster.

    Returns:
        The next state, and the output of shape (joints,); None where no tick is due or the gate is disarmed.
    """
    if now < state.due:
        return state, None
    state = _watch(state, rules, now)
    motion = _next_motion(state, rules, now)
    state = _timed_rest(replace(state, motion=motion, due=now + rules.period), rules, now)
    return state, motion.value if motion and state.is_armed else None


def armed(state: Gate, rules: Rules, now: float) -> tuple[Gate, str]:
    """Arm a gate at a person's word; return the reason if it refuses, else nothing.

    A gate that is not moving then takes commands of any process, whatever numbers it heard before.
    """
    if state.mode == Mode.MOVING:
        return state, ""
    obstacle = _obstacle(state, rules, now) if state.mode != Mode.HOLDING else ""
    if obstacle:
        return state, obstacle
    if not state.is_armed:
        anchor = state.sensed.position if state.sensed is not None else None
        state = replace(state, motion=_start(state.sensed, rules.limits), anchor=anchor)
    return replace(state, mode=Mode.HOLDING, reason="", goal=None, sender=-1, number=-1), ""


def stopped(state: Gate, reason: str) -> Gate:
    """Come to rest and hold until armed again; a gate that is disarmed or stopped stays as it is."""
    if state.mode not in (Mode.HOLDING, Mode.MOVING):
        return state
    return _count(replace(_held(state), mode=Mode.STOPPED, reason=reason), stops=1)


def stop_asked(state: Gate, reason: str) -> Gate:
    """Stop, and refuse to be armed, as long as there is a reason: who requests a stop, in words."""
    state = replace(state, stop_asked=reason)
    return stopped(state, reason) if reason else state


def leave(state: Gate, rules: Rules, now: float) -> tuple[Gate, bool]:
    """Stop the robot for good, and let go of it when it is at rest; return whether nothing remains to be sent.

    A robot may keep the newest command for ever, so efforts go to 0 last: none is right without a look at the joints.
    """
    state = replace(stopped(state, "the gate ends"), is_leaving=True)
    motion = state.motion
    if not state.is_armed or motion is None:
        return state, True
    state = replace(state, lets_go=state.lets_go or is_at_rest(state, rules, now))
    is_pushing = rules.limits.kind == EFFORT and bool(motion.value.any())
    return state, state.lets_go and not is_pushing


def last_output(state: Gate, rules: Rules) -> Setpoint | None:
    """Return the output to send when no other will follow, at rest or not; None if there is none to send.

    Velocities and efforts become 0 at once. Positions stay: the newest one is held already.
    """
    is_held = not state.is_armed or rules.limits.kind == POSITION
    return None if is_held else rest_at(np.zeros(rules.limits.joints))


def is_at_rest(state: Gate, rules: Rules, now: float) -> bool:
    """Return whether the robot has been at rest for long enough: one reading may be that of a turning point."""
    return not state.is_armed or now - state.rest_since >= rules.rest_time


def _count(state: Gate, **more: int) -> Gate:
    counts = replace(state.counts, **{name: getattr(state.counts, name) + n for name, n in more.items()})
    return replace(state, counts=counts)


def _held(state: Gate) -> Gate:
    """Come to rest, and expect no further command; joints that hold by effort brake first, see `_anchored`."""
    mode = Mode.HOLDING if state.mode == Mode.MOVING else state.mode
    if state.goal is not None and state.sensed is not None:
        state = replace(state, anchor=state.sensed.position, swing=state.sensed.velocity)
    return replace(state, mode=mode, goal=None)


def _anchored(state: Gate) -> Gate:
    """Hold joints where they first turn after a motion: the spring that braked them does not pull them back."""
    if state.sensed is None or state.anchor is None or state.swing is None:
        return state
    turns = np.sign(state.swing) * np.sign(state.sensed.velocity) < 0
    anchor = np.where(turns, state.sensed.position, state.anchor)
    return replace(state, anchor=anchor, swing=np.where(turns, 0.0, state.swing))


def _timed_rest(state: Gate, rules: Rules, now: float) -> Gate:
    """Note since when the robot has been at rest, and forget it when it moves."""
    since = min(state.rest_since, now) if _is_still(state, rules, now) else np.inf
    return replace(state, rest_since=since)


def _is_still(state: Gate, rules: Rules, now: float) -> bool:
    """Return whether the robot does not move now, by its commands, and of efforts by what is sensed."""
    if state.goal is not None or state.motion is None:
        return False
    if rules.limits.kind != EFFORT:
        return not (state.motion.rate if rules.limits.kind == POSITION else state.motion.value).any()
    if state.sensed is None or _stale(state, rules, now):
        return False
    return bool((np.abs(state.sensed.velocity) <= rules.rest_speed).all())


def _objection(state: Gate, rules: Rules, now: float, command: Command) -> str:
    """Return why a command is not to be taken; empty where it is."""
    greatest = max(command.instance, command.number)
    if greatest > MOST_NUMBER:
        return f"expected numbers of a process and of a command of at most {MOST_NUMBER}, got {greatest}"
    if state.goal is not None and command.instance != state.sender:
        return f"expected commands of process {state.sender} until it holds, got one of {command.instance}"
    if command.instance < state.sender:
        return f"expected a process not before {state.sender}, got {command.instance}"
    if command.instance == state.sender and command.number <= state.number:
        return f"expected a number above {state.number}, got {command.number}"
    age = now - command.stamp
    if not -CLOCK_TOLERANCE_S <= age <= rules.command_timeout:
        return f"expected a stamp of the last {rules.command_timeout:g} s, got an age of {age:.3f} s"
    values = command.values
    if values is not None and np.shape(values) != (rules.limits.joints,):
        return f"expected {rules.limits.joints} values, got {np.size(values)}"
    if values is not None and not np.isfinite(values).all():
        return f"expected finite values, got {values}"
    return ""


def _clamp(limits: Limits, value: Array, asked: Array) -> tuple[Array, Flags]:
    """Return the nearest command to the one asked for, of those within the range and a step's reach."""
    goal = np.clip(asked, *limits.bounds())
    near = np.clip(goal, value - limits.step, value + limits.step)
    flags = Flags.CLAMPED_VALUE if (goal != asked).any() else Flags(0)
    return near, flags | Flags.CLAMPED_STEP if (near != goal).any() else flags


def _foresee(rules: Rules, motion: Setpoint, goal: Array, interval: float) -> tuple[Array, Flags]:
    """Return what the output comes to within an interval, the timeout at most, and what keeps it from its goal."""
    periods = max(round(min(interval, rules.command_timeout) / rules.period), 1)
    start = motion.value
    for _ in range(periods):
        motion = advance(rules.limits, rules.period, motion, goal)
        if _is_same(motion.value, goal):
            return goal, Flags(0)
    is_too_far = bool((np.abs(goal - start) > rules.limits.rate * (periods * rules.period)).any())
    flag = {POSITION: is_too_far, VELOCITY: False, EFFORT: True}[rules.limits.kind]
    return motion.value, Flags.CLAMPED_VELOCITY if flag else Flags.CLAMPED_ACCELERATION


def _is_same(value: Array, goal: Array) -> bool:
    return bool((np.abs(value - goal) <= SAME * (1.0 + np.abs(goal))).all())


def _flaw(state: Gate, rules: Rules, now: float, news: Sensed) -> str:
    """Return why what was sensed cannot be used; empty where it can."""
    age = now - news.stamp
    if not -CLOCK_TOLERANCE_S <= age <= rules.stale_after:
        return f"expected a stamp of the last {rules.stale_after:g} s, got an age of {age:.3f} s"
    if state.sensed is not None and news.stamp < state.sensed.stamp:
        return "expected a stamp not before the last one, got one that is"
    for name in rules.fields:
        if not (np.abs(getattr(news, name)) <= MOST).all():
            return f"expected {name} of all joints, within {MOST:g}, got {getattr(news, name)}"
    return ""


def _stale(state: Gate, rules: Rules, now: float) -> str:
    """Return in words that what was sensed is too old; empty where it is not, or where nothing need be sensed."""
    if rules.stale_after == np.inf:
        return ""
    if state.sensed is None:
        return "expected the joints to be sensed, got nothing that can be used"
    is_stale = now - state.sensed.stamp > rules.stale_after
    return f"nothing was sensed of the joints for {rules.stale_after:g} s that can be used" if is_stale else ""


def _watch(state: Gate, rules: Rules, now: float) -> Gate:
    """Stop where commands fail to come, what was sensed is too old or the gate is late; a dry run just ends."""
    is_silent = state.goal is not None and now - state.heard_at > rules.command_timeout
    if is_silent and not state.is_armed:
        return _held(state)
    fault = f"no command for {rules.command_timeout:g} s" if is_silent else _stale(state, rules, now)
    late = now - state.due if np.isfinite(state.due) else 0.0  # the first tick is never late
    if late > min(rules.command_timeout, rules.stale_after):  # what was not heard meanwhile is no fault of others
        fault = f"the gate itself was late by {late:.2f} s"
    return stopped(state, fault) if fault else state


def _next_motion(state: Gate, rules: Rules, now: float) -> Setpoint | None:
    """Return the next output; while disarmed and without a goal, where an armed one would begin."""
    if state.motion is None or (not state.is_armed and state.goal is None):
        return _start(state.sensed, rules.limits)
    goal = state.goal
    if goal is None and rules.limits.kind == EFFORT:
        goal = _holding_effort(state, rules, now)
    return advance(rules.limits, rules.period, state.motion, goal)


def _start(now_sensed: Sensed | None, limits: Limits) -> Setpoint | None:
    """Return the output that changes nothing: positions where they are sensed, else 0."""
    if limits.kind != POSITION:
        return rest_at(np.zeros(limits.joints))
    return rest_at(np.clip(now_sensed.position, limits.minimum, limits.maximum)) if now_sensed is not None else None


def _holding_effort(state: Gate, rules: Rules, now: float) -> Array:
    """Return the effort of a spring and a damper at the anchor.

    Where nothing is sensed any more the damper is left out, and the spring goes by what was sensed last: what it bore
    of a load it bears on, and it drives nothing that it cannot see.
    """
    joints = state.sensed
    if joints is None or state.anchor is None or state.lets_go:
        return np.zeros(rules.limits.joints)
    damping = np.zeros_like(rules.damping) if _stale(state, rules, now) else rules.damping
    effort = rules.stiffness * (state.anchor - joints.position) - damping * joints.velocity
    return np.clip(effort, *rules.limits.bounds())


def _obstacle(state: Gate, rules: Rules, now: float) -> str:
    """Return why a gate cannot be armed now; empty where it can."""
    if state.is_leaving:
        return "expected a gate that goes on, got one that ends"
    if state.stop_asked:
        return f"cannot arm while {state.stop_asked}"
    stale = _stale(state, rules, now)
    if stale or state.sensed is None:
        return stale
    if passed := next(rules.sensed.passed(state.sensed), ""):
        return passed
    start = _start(state.sensed, rules.limits)
    if state.is_armed or rules.limits.kind != POSITION or start is None:
        return ""
    way = np.abs(start.value - state.sensed.position)
    beyond = bool((way > np.minimum(rules.limits.velocity * rules.period, rules.limits.step)).any())
    return f"expected joints within their limits, got positions {state.sensed.position}" if beyond else ""
