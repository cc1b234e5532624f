"""The safety gate between the senders of commands and a robot's hardware, as pure functions.

A `Gate` is a frozen state. Each command, each sensed joint state and each clock tick maps it to the next state.
Outputs are produced at ticks only. All times, including message stamps, are seconds of one monotonic clock. The gate
stops for silent senders of commands; whether the learner is alive is known to ``rkhs_ros.nodes.robot.robot_driver``.
"""

from dataclasses import replace

import numpy as np

from rkhs_ros.rkhs.kernels import Array
from rkhs_ros.robot.feedback import CLOCK_TOLERANCE_S, NOISE, compared, contradiction, flaw, runaway, stale
from rkhs_ros.robot.gate_state import (
    CLAMPED,
    STOP_REQUESTED,
    Command,
    CommandReport,
    Flags,
    Gate,
    Mode,
    Rules,
)
from rkhs_ros.robot.limits import EFFORT, POSITION, VELOCITY, Limits, Sensed, Setpoint, advance, rest_at

SAME = 1e-9  # commands are equal up to this relative difference
MOST_PERIODS = 1000  # that a report looks ahead, so that it takes milliseconds at most


def begin(rules: Rules) -> Gate:
    """Return the initial state of a gate, which is disarmed."""
    return Gate(motion=None if rules.limits.kind == POSITION else rest_at(np.zeros(rules.limits.joints)))


def commanded(state: Gate, rules: Rules, now: float, command: Command) -> tuple[Gate, CommandReport]:
    """Accept or refuse a command; return the next state and the report of the command."""
    state, motion = _count(state, commands=1), state.motion
    reason = _objection(state, rules, now, command)
    if motion is None or reason:
        newest = motion.value if motion else np.zeros(0)
        refusal = reason or "cannot take a command before the positions of the joints are sensed"
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
    """Take a sensed joint state, and stop if it exceeds a limit or contradicts others; return why it is refused or "".

    A refused state does not replace the previous one, which therefore becomes stale.
    """
    reason = flaw(state, rules, now, news)
    if reason:
        return _count(state, refusals=1), reason
    state = runaway(compared(_let_go(state, rules, now, news), rules, now, news), rules, now, news)
    state = _timed_rest(_anchored(replace(state, sensed=news)), rules, now)
    if reason := contradiction(state, now):  # no effort is safe without feedback
        state = stopped(state, reason)
        return replace(state, releases=state.releases or rules.limits.kind == EFFORT), ""
    exceeded = next(rules.sensed.exceeded(news), "")
    return stopped(state, exceeded) if exceeded else state, ""


def ticked(state: Gate, rules: Rules, now: float) -> tuple[Gate, Array | None]:
    """Advance by one period if a period has passed since the last tick; return the next state and the output.

    Outputs are at least one period apart, also after a late tick. A change that respects a limit per period therefore
    also respects it per second. The output has the shape (joints,); it is None if none is due or the gate is disarmed.
    """
    if now < state.due:
        return state, None
    state = _watch(state, rules, now)
    motion = _next_motion(state, rules, now)
    state = _timed_rest(replace(state, motion=motion, due=now + rules.period), rules, now)
    return state, motion.value if motion and state.is_armed else None


def armed(state: Gate, rules: Rules, now: float) -> tuple[Gate, str]:
    """Arm the gate on request; return the next state and the reason if it refuses, else an empty string.

    After a stop by the operator, a disarmed gate refuses once. A gate that is not moving then accepts commands of any
    process, whatever numbers it has received before.
    """
    if state.mode == Mode.MOVING:
        return state, ""
    if state.mode == Mode.DISARMED and state.reason:
        return replace(state, reason=""), f"cannot arm: {state.reason}; arm again if the robot may move"
    obstacle = _obstacle(state, rules, now) if state.mode != Mode.HOLDING else ""
    if obstacle:
        return state, obstacle
    if not state.is_armed:
        state = replace(state, motion=_start(state.sensed, rules.limits))
    if not state.is_armed or state.releases:  # a released joint may be elsewhere by now
        state = replace(state, anchor=state.sensed.position if state.sensed is not None else None, swing=None)
    state = replace(state, releases=False, stopped_at=np.inf, top_speed=None)
    return replace(state, mode=Mode.HOLDING, reason="", goal=None, sender=-1, number=-1), ""


def stopped(state: Gate, reason: str) -> Gate:
    """Come to rest and hold until armed again; do nothing if the gate is disarmed or stopped."""
    if state.mode not in (Mode.HOLDING, Mode.MOVING):
        return state
    return _count(replace(_held(state), mode=Mode.STOPPED, reason=reason), stops=1)


def disarmed(state: Gate, reason: str) -> Gate:
    """Send nothing until armed again; the next request to arm is refused."""
    return replace(stopped(state, reason), mode=Mode.DISARMED, reason=reason)


def stop_requested(state: Gate, reason: str) -> Gate:
    """Stop, and refuse to arm, while `reason` names who requests a stop; it is empty if no stop is requested."""
    state = replace(state, stop_requested=reason)
    is_new = bool(reason) and not state.reason.startswith(STOP_REQUESTED)
    return stopped_by_operator(state, reason) if is_new and state.is_armed else state


def stopped_by_operator(state: Gate, reason: str) -> Gate:
    """Stop until armed again; a disarmed gate rejects the next request to arm, and names the stop request."""
    return replace(stopped(state, reason), reason=reason)


def leave(state: Gate, rules: Rules, now: float) -> tuple[Gate, bool]:
    """Stop the robot for good, and release it when it is at rest; return whether nothing remains to be sent.

    Hardware may hold the newest command for ever. Efforts therefore go to 0 last: without feedback no other is safe.
    """
    state = replace(stopped(state, "the gate is shutting down"), is_shutting_down=True)
    motion = state.motion
    if not state.is_armed or motion is None:
        return state, True
    state = replace(state, releases=state.releases or is_at_rest(state, rules, now))
    is_pushing = rules.limits.kind == EFFORT and bool(motion.value.any())
    return state, state.releases and not is_pushing


def last_output(state: Gate, rules: Rules) -> Setpoint | None:
    """Return the last output of a gate, whether the robot is at rest or not; None if none need be sent.

    Velocities and efforts become 0 at once. Positions need none: the hardware holds the newest one already.
    """
    is_held = not state.is_armed or rules.limits.kind == POSITION
    return None if is_held else rest_at(np.zeros(rules.limits.joints))


def is_at_rest(state: Gate, rules: Rules, now: float) -> bool:
    """Return whether the robot has been at rest for ``rules.rest_time``; one reading may be a turning point."""
    return not state.is_armed or now - state.rest_since >= rules.rest_time


def _count(state: Gate, **more: int) -> Gate:
    counts = replace(state.counts, **{name: getattr(state.counts, name) + n for name, n in more.items()})
    return replace(state, counts=counts)


def _held(state: Gate) -> Gate:
    """Come to rest and expect no further command; joints that hold by effort brake first, see `_anchored`."""
    mode = Mode.HOLDING if state.mode == Mode.MOVING else state.mode
    if state.goal is not None and state.sensed is not None:
        state = replace(state, anchor=state.sensed.position, swing=state.sensed.velocity)
    return replace(state, mode=mode, goal=None)


def _let_go(state: Gate, rules: Rules, now: float, news: Sensed) -> Gate:
    """Do not pull back a robot that was moved while no joint state arrived, for example without power.

    Efforts hold a joint that is at rest elsewhere; one that moves would sink under a load with each of many silences.
    Positions disarm the gate unless the joints are where they were sent, up to the lag of a motion.
    """
    before, motion = state.sensed, state.motion
    if not state.is_armed or state.goal is not None or before is None or motion is None or not stale(state, rules, now):
        return state
    if rules.limits.kind == EFFORT and state.anchor is not None:
        are_at_rest = [np.abs(each.velocity) <= rules.rest_speed for each in (before, news)]
        is_elsewhere = np.abs(news.position - before.position) > NOISE
        anchor = np.where(np.all([*are_at_rest, is_elsewhere], axis=0), news.position, state.anchor)
        return replace(state, anchor=anchor)
    if rules.limits.kind != POSITION:
        return state
    lag = NOISE + np.abs(motion.rate) * rules.stale_after
    moved = np.flatnonzero(np.abs(news.position - motion.value) > lag)
    if not moved.size:
        return state
    reason = f"joint {moved[0]} was not where it was sent after no joint state had arrived"
    return replace(state, mode=Mode.DISARMED, reason=reason)


def _anchored(state: Gate) -> Gate:
    """Hold each joint where it first turns after a motion, so that the braking spring does not pull it back."""
    if state.sensed is None or state.anchor is None or state.swing is None:
        return state
    turns = np.sign(state.swing) * np.sign(state.sensed.velocity) < 0
    anchor = np.where(turns, state.sensed.position, state.anchor)
    return replace(state, anchor=anchor, swing=np.where(turns, 0.0, state.swing))


def _timed_rest(state: Gate, rules: Rules, now: float) -> Gate:
    """Record since when the robot has been at rest; reset when it moves."""
    since = min(state.rest_since, now) if _is_still(state, rules, now) else np.inf
    return state if since == state.rest_since else replace(state, rest_since=since)


def _is_still(state: Gate, rules: Rules, now: float) -> bool:
    """Return whether the robot is at rest now, judged by its commands, or by sensing if they are efforts."""
    if state.goal is not None or state.motion is None:
        return False
    if rules.limits.kind != EFFORT:
        return not (state.motion.rate if rules.limits.kind == POSITION else state.motion.value).any()
    if state.sensed is None or stale(state, rules, now):
        return False
    return bool((np.abs(state.sensed.velocity) <= rules.rest_speed).all())


def _objection(state: Gate, rules: Rules, now: float, command: Command) -> str:
    """Return why a command is refused; empty if it is accepted."""
    if state.goal is not None and command.instance != state.sender:
        return f"command: expected instance {state.sender}, which is moving the robot, got {command.instance}"
    if command.instance < state.sender:
        return f"command: expected instance {state.sender} or a newer one, got {command.instance}"
    if command.instance == state.sender and command.number <= state.number:
        return f"command: expected a number above {state.number}, got {command.number}"
    age = now - command.stamp
    if not -CLOCK_TOLERANCE_S <= age <= rules.command_timeout:
        return f"command: expected a stamp within the last {rules.command_timeout:g} s, got an age of {age:.3f} s"
    values = command.values
    if values is not None and np.shape(values) != (rules.limits.joints,):
        return f"command: expected {rules.limits.joints} values, got {np.size(values)}"
    if values is not None and not np.isfinite(values).all():
        return f"command: expected finite values, got {values}"
    return ""


def _clamp(limits: Limits, value: Array, asked: Array) -> tuple[Array, Flags]:
    """Return the requested command, clipped to the range and to the reach of one step, and the flags of the clips."""
    goal = np.clip(asked, *limits.bounds())
    near = np.clip(goal, value - limits.step, value + limits.step)
    flags = Flags.CLAMPED_VALUE if (goal != asked).any() else Flags(0)
    return near, flags | Flags.CLAMPED_STEP if (near != goal).any() else flags


def _foresee(rules: Rules, motion: Setpoint, goal: Array, interval: float) -> tuple[Array, Flags]:
    """Return the output after an interval (the timeout at most), and which limit keeps it from its goal."""
    periods = min(max(round(min(interval, rules.command_timeout) / rules.period), 1), MOST_PERIODS)
    value = advance(rules.limits, rules.period, motion, goal, periods).value
    if (np.abs(value - goal) <= SAME * (1.0 + np.abs(goal))).all():
        return goal, Flags(0)
    is_too_far = bool((np.abs(goal - motion.value) > rules.limits.rate * (periods * rules.period)).any())
    flag = {POSITION: is_too_far, VELOCITY: False, EFFORT: True}[rules.limits.kind]
    return value, Flags.CLAMPED_VELOCITY if flag else Flags.CLAMPED_ACCELERATION


def _watch(state: Gate, rules: Rules, now: float) -> Gate:
    """Stop if commands fail to arrive, the sensed state is stale or the gate is late; a dry run just ends."""
    is_silent = state.goal is not None and now - state.heard_at > rules.command_timeout
    if is_silent and not state.is_armed:
        return _held(state)
    fault = f"no command for {rules.command_timeout:g} s" if is_silent else stale(state, rules, now)
    late = now - state.due if np.isfinite(state.due) else 0.0  # the first tick is never late
    if late > min(rules.command_timeout, rules.stale_after):  # messages missed meanwhile are not the senders' fault
        fault = f"the gate itself was late by {late:.2f} s"
    return stopped(state, fault) if fault else state


def _next_motion(state: Gate, rules: Rules, now: float) -> Setpoint | None:
    """Return the next output; while disarmed and without a goal, return the output with which arming would begin."""
    if state.motion is None or (not state.is_armed and state.goal is None):
        return _start(state.sensed, rules.limits)
    goal = state.goal
    if goal is None and rules.limits.kind == EFFORT:
        goal = _holding_effort(state, rules, now)
    return advance(rules.limits, rules.period, state.motion, goal)


def _start(now_sensed: Sensed | None, limits: Limits) -> Setpoint | None:
    """Return the output that does not move the robot: the sensed positions, or velocities and efforts of 0."""
    if limits.kind != POSITION:
        return rest_at(np.zeros(limits.joints))
    return rest_at(np.clip(now_sensed.position, limits.minimum, limits.maximum)) if now_sensed is not None else None


def _holding_effort(state: Gate, rules: Rules, now: float) -> Array:
    """Return the effort of a spring and a damper at the anchor.

    If the sensed state is stale, the damper is omitted and the spring uses the last position: it keeps bearing its
    load, and drives no joint without feedback.
    """
    joints = state.sensed
    if joints is None or state.anchor is None or state.releases:
        return np.zeros(rules.limits.joints)
    damping = np.zeros_like(rules.damping) if stale(state, rules, now) else rules.damping
    effort = rules.stiffness * (state.anchor - joints.position) - damping * joints.velocity
    return np.clip(effort, *rules.limits.bounds())


def _obstacle(state: Gate, rules: Rules, now: float) -> str:
    """Return why the gate cannot be armed now; empty if it can."""
    if state.is_shutting_down:
        return "cannot arm while the gate is shutting down"
    if state.stop_requested:
        return f"cannot arm while {state.stop_requested}"
    fault = stale(state, rules, now) or contradiction(state, now)
    if fault or state.sensed is None:
        return f"cannot arm: {fault}" if fault else ""
    if exceeded := next(rules.sensed.exceeded(state.sensed), ""):
        return f"cannot arm: {exceeded}"
    start = _start(state.sensed, rules.limits)
    if state.is_armed or rules.limits.kind != POSITION or start is None:
        return ""
    way = np.abs(start.value - state.sensed.position)
    beyond = bool((way > np.minimum(rules.limits.velocity * rules.period, rules.limits.step)).any())
    return f"cannot arm: expected joints within their limits, got positions {state.sensed.position}" if beyond else ""
