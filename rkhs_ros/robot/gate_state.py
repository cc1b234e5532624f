"""What a gate is made of: its rules, its state, the commands it takes and its reports, all frozen values."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import IntFlag, StrEnum

import numpy as np

from rkhs_ros.base.validation import require
from rkhs_ros.rkhs.kernels import Array
from rkhs_ros.robot.limits import EFFORT, LEAST, MOST, POSITION, VELOCITY, Limits, Sensed, SensedLimits
from rkhs_ros.robot.motion import Setpoint

MOST_NUMBER = 2**63 - 1  # of a process and of its commands; a parameter of ROS can be no greater
STOP_ASKED = "a stop is requested"  # how the reason begins where somebody had the robot stop


class Mode(StrEnum):
    """What a gate does."""

    DISARMED = "disarmed"
    HOLDING = "holding"
    MOVING = "moving"
    STOPPED = "stopped"


class Flags(IntFlag):
    """What happened to a command."""

    CLAMPED_VALUE = 1
    CLAMPED_VELOCITY = 2
    CLAMPED_ACCELERATION = 4
    CLAMPED_STEP = 8
    REFUSED = 16
    NOT_ARMED = 32


CLAMPED = Flags.CLAMPED_VALUE | Flags.CLAMPED_VELOCITY | Flags.CLAMPED_ACCELERATION | Flags.CLAMPED_STEP


@dataclass(frozen=True, eq=False)
class Rules:
    """What a gate goes by, fixed as long as it lives.

    Attributes:
        limits: of commands.
        sensed: limits of what is sensed.
        stiffness: of joints that hold by effort, N m/rad or N/m, shape (joints,).
        damping: of joints that hold by effort, N m s/rad or N s/m, shape (joints,).
        command_timeout: seconds without a command after which a motion is stopped.
        stale_after: seconds after which what was sensed is too old; infinity where nothing is sensed.
        period: seconds between outputs, at least.
        rest_speed: rad/s or m/s sensed of a joint, up to which one that holds by effort is taken to be at rest.
        rest_time: seconds for which a robot must be at rest without a break before it is left.

    Raises:
        ValueError: they do not fit each other.
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
        joints = self.limits.joints
        require(len(self.sensed.minimum) == joints, "sensed", f"limits of {joints} joints", len(self.sensed.minimum))
        for name in ("stiffness", "damping"):
            gains = np.asarray(getattr(self, name))
            good = gains.shape == (joints,) and bool(((gains >= 0) & (gains <= MOST)).all())
            require(good, f"hold.{name}", f"{joints} numbers from 0 to {MOST:g}", gains)
        for name in ("command_timeout", "stale_after", "period"):
            require(getattr(self, name) >= LEAST, name, "a time above 0", getattr(self, name))
        for name in ("rest_speed", "rest_time"):
            require(0.0 <= getattr(self, name) < np.inf, name, "a number from 0", getattr(self, name))
        require(self.period <= self.command_timeout < np.inf, "period", "at most command_timeout", self.period)
        blind = self.stale_after == np.inf
        require(not (blind and self.fields), "sensor", f"a topic that tells {', '.join(self.fields)}", "none")

    @property
    def fields(self) -> list[str]:
        """What of the joints must be sensed."""
        to_hold = {POSITION: {POSITION}, VELOCITY: set(), EFFORT: {POSITION, VELOCITY}}[self.limits.kind]
        return sorted(to_hold | self.sensed.fields)


@dataclass(frozen=True, eq=False)
class Command:
    """What a robot is to do next.

    Attributes:
        instance: the sender's process; a later one has a greater number.
        number: of the command, which grows with each.
        stamp: when the observation that it follows from was taken, in seconds of the gate's clock.
        values: shape (joints,); None to come to rest and hold.
    """

    instance: int
    number: int
    stamp: float
    values: Array | None


@dataclass(frozen=True, eq=False)
class CommandReport:
    """What became of a command.

    Attributes:
        executed: what the output comes to by the time the next command is due, shape (joints,), as far as commands
            came regularly; what it would come to where the gate is disarmed; the newest output where the command was
            refused; empty for a hold, and where there is none.
        flags: what happened to it.
        reason: why it was refused; else empty.
    """

    executed: Array
    flags: Flags = Flags(0)
    reason: str = ""


@dataclass(frozen=True)
class Counts:
    """Counted since a gate began: commands heard, commands changed by a limit, messages refused, and stops."""

    commands: int = 0
    clamps: int = 0
    refusals: int = 0
    stops: int = 0


@dataclass(frozen=True, eq=False)
class Gate:
    """A gate between two events.

    Attributes:
        mode: what it does.
        reason: why it is stopped; else empty.
        counts: what it counted.
        motion: the newest output, as long as it is disarmed the one that would be; None while positions are unknown.
        goal: the command to go to, shape (joints,); None while none is due.
        anchor: position to hold by effort, shape (joints,).
        swing: velocities with which joints that hold by effort came to their anchor, shape (joints,); 0 of one that
            has turned since.
        sensed: what was sensed last; None before.
        heard_at: time of the newest command taken.
        sender: process that it came from.
        number: of that command.
        stop_asked: who keeps asking for a stop, in words; empty if nobody.
        due: time of the next tick.
        rest_since: time since which the robot has been at rest without a break; infinity while it is not.
        is_leaving: whether the gate ends, and is not to be armed again.
        lets_go: whether efforts go to 0 in place of holding, as the last thing before the gate ends.
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
    stop_asked: str = ""
    due: float = -np.inf
    rest_since: float = np.inf
    is_leaving: bool = False
    lets_go: bool = False

    @property
    def is_armed(self) -> bool:
        """Whether outputs are sent."""
        return self.mode != Mode.DISARMED
