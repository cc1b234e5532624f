"""Frozen values of the gate: its rules, its state, the commands it receives, stop requests and reports."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from enum import IntFlag, StrEnum
from functools import cached_property
from math import inf

import numpy as np

from rkhs_ros.base.validation import require
from rkhs_ros.rkhs.kernels import Array
from rkhs_ros.robot.limits import EFFORT, POSITION, VELOCITY, Limits, Sensed, SensedLimits, Setpoint

STOP_REQUESTED = "a stop is requested"  # prefix of the reason for a requested stop


class Mode(StrEnum):
    """Mode of a gate."""

    DISARMED = "disarmed"
    HOLDING = "holding"
    MOVING = "moving"
    STOPPED = "stopped"


class Flags(IntFlag):
    """Flags of a command in the gate's report."""

    CLAMPED_VALUE = 1
    CLAMPED_VELOCITY = 2
    CLAMPED_ACCELERATION = 4
    CLAMPED_STEP = 8
    REFUSED = 16
    NOT_ARMED = 32


CLAMPED = Flags.CLAMPED_VALUE | Flags.CLAMPED_VELOCITY | Flags.CLAMPED_ACCELERATION | Flags.CLAMPED_STEP


@dataclass(frozen=True, eq=False)
class Rules:
    """The rules of a gate, fixed for its lifetime.

    Attributes:
        limits: of commands.
        sensed: limits of the sensed joint states.
        stiffness: of joints that hold by effort, N m/rad or N/m, shape (joints,).
        damping: of joints that hold by effort, N m s/rad or N s/m, shape (joints,).
        command_timeout: seconds without a command after which the gate stops a motion.
        stale_after: seconds after which a sensed state is stale; infinity without a sensor.
        period: least seconds between outputs.
        rest_speed: greatest sensed speed, rad/s or m/s, of a joint at rest that holds by effort.
        rest_time: seconds for which a robot must stay at rest before its gate exits.

    Raises:
        ValueError: the rules are inconsistent.
    """

    limits: Limits
    sensed: SensedLimits
    stiffness: Array
    damping: Array
    command_timeout: float
    stale_after: float
    period: float
    rest_speed: float
    rest_time: float

    def __post_init__(self) -> None:
        require(self.period <= self.command_timeout, "period", "at most command_timeout", self.period)
        blind = self.stale_after == np.inf
        require(not (blind and self.fields), "sensor", f"a topic with {', '.join(self.fields)}", "none")

    @cached_property
    def fields(self) -> list[str]:
        """Quantities that must be sensed."""
        to_hold = {POSITION: {POSITION}, VELOCITY: set(), EFFORT: {POSITION, VELOCITY}}[self.limits.kind]
        return sorted(to_hold | self.sensed.fields)


@dataclass(frozen=True, eq=False)
class Command:
    """A command to a robot.

    Attributes:
        instance: the sender's process; a newer process has a greater number.
        number: of the command; increases with each.
        stamp: time of the observation that the command is based on, in seconds of the gate's clock.
        values: shape (joints,); None to come to rest and hold.
    """

    instance: int
    number: int
    stamp: float
    values: Array | None


@dataclass(frozen=True, eq=False)
class CommandReport:
    """The gate's report of a command.

    Attributes:
        executed: the output at the time the next command is due, if commands arrive regularly, shape (joints,).
            Of a disarmed gate, the output that an armed one would reach. The newest output if the command was refused.
            Empty for a hold, or if there is no output yet.
        flags: limits that changed the command, and whether it was refused.
        reason: why it was refused; else empty.
    """

    executed: Array
    flags: Flags = Flags(0)
    reason: str = ""


@dataclass(frozen=True)
class Counts:
    """Counters since the gate started: commands received, commands clamped, messages refused, and stops."""

    commands: int = 0
    clamps: int = 0
    refusals: int = 0
    stops: int = 0


@dataclass(frozen=True, eq=False)
class Gate:
    """The state of a gate between two events.

    Attributes:
        mode: of the gate.
        reason: why it is stopped, or refuses once to arm; else empty.
        counts: its counters.
        motion: the newest output; while disarmed, the one that it would send; None while positions are unknown.
        goal: the command to move to, shape (joints,); None while no command is expected.
        anchor: position to hold by effort, shape (joints,).
        swing: velocities with which joints that hold by effort reached their anchor, shape (joints,); 0 for a joint
            that has turned since.
        sensed: the last sensed state; None before the first one.
        heard_at: time of the newest accepted command.
        sender: instance that sent it.
        number: of that command.
        stop_requested: reason of the requested stop, with its publishers; empty if there is none.
        due: time of the next tick.
        rest_since: time since which the robot has been at rest; infinity while it moves.
        jump: direction of the last jump of a sensed position, shape (joints,), 0 for joints that did not jump.
        jumped_at: time of that jump.
        contradiction: why the sensed states contradict each other; empty if they did not at the last jump.
        stopped_at: time of the first sensed state after a stop, for joints that hold by effort.
        top_speed: greatest sensed speeds soon after that stop, shape (joints,).
        is_shutting_down: whether the gate is about to exit and cannot be armed again.
        releases: whether efforts go to 0 instead of holding: the gate is about to exit, or its feedback is wrong.
    """

    mode: Mode = Mode.DISARMED
    reason: str = ""
    counts: Counts = field(default_factory=Counts)
    motion: Setpoint | None = None
    goal: Array | None = None
    anchor: Array | None = None
    swing: Array | None = None
    sensed: Sensed | None = None
    heard_at: float = -np.inf
    sender: int = -1
    number: int = -1
    stop_requested: str = ""
    due: float = -np.inf
    rest_since: float = np.inf
    jump: Array | None = None
    jumped_at: float = -np.inf
    contradiction: str = ""
    stopped_at: float = np.inf
    top_speed: Array | None = None
    is_shutting_down: bool = False
    releases: bool = False

    @property
    def is_armed(self) -> bool:
        """Whether outputs are sent."""
        return self.mode != Mode.DISARMED


Publishers = Mapping[bytes, str]  # names of their nodes by the identifiers of the publishers


@dataclass(frozen=True)
class StopRequests:
    """The stop requests on a topic.

    A message arrives through each subscription that matches its publisher: in order, but not at the same time, and
    through some perhaps never. A request therefore stands until it is cleared on each subscription that received it. A
    message does not name its publisher, so none clears a request while the topic has more than one.

    Attributes:
        topic: its name, for messages.
        timeout: seconds without a message that mean stop; 0 for no timeout.
        publishers: of the topic, at present.
        requests: subscriptions whose newest message requests a stop, with the publishers that may have sent it.
        heard_at: monotonic time of the newest message, seconds.
    """

    topic: str
    timeout: float = 0.0
    publishers: Publishers = field(default_factory=dict)
    requests: Mapping[int, Publishers] = field(default_factory=dict)
    heard_at: float = -inf

    def heard(self, subscription: int, now: float, *, is_stop: bool) -> StopRequests:
        """Return the requests after a message, which arrived through one of the subscriptions."""
        requests = dict(self.requests)
        if is_stop:
            requests[subscription] = self.publishers
        elif len(self.publishers) < 2:
            requests.pop(subscription, None)
        return replace(self, requests=requests, heard_at=now)

    def without_departed(self) -> StopRequests:
        """Remove requests whose publishers have all left, which only an operator who arms the gate may do."""
        present = {each: senders for each, senders in self.requests.items() if senders.keys() & self.publishers.keys()}
        return replace(self, requests=present)

    def reason(self, now: float) -> str:
        """Return why the robot must stop at a monotonic time, seconds; empty if it need not."""
        on_topic = f"{STOP_REQUESTED} on the topic '{self.topic}'"
        if self.requests:
            senders = [
                self.publishers.get(each, name) for all_ in self.requests.values() for each, name in all_.items()
            ]
            return f"{on_topic} by {_listed(senders, ' or ') or 'a node that has left'}"
        if len(self.publishers) > 1:
            return f"{on_topic} by more than one publisher: {_listed(self.publishers.values(), ', ')}"
        if self.timeout and now - self.heard_at > self.timeout:
            silent = _listed(self.publishers.values(), ", ") or "all nodes"
            return f"{on_topic} by the silence of {silent} (stop_timeout {self.timeout:g} s)"
        return ""


def _listed(names: Iterable[str], separator: str) -> str:
    return separator.join(sorted(set(names)))
