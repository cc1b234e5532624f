"""Resets: the steps that bring a robot to the start of an episode."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from rkhs_ros.base.settings import Settings, setting
from rkhs_ros.base.validation import numbers, require
from rkhs_ros.rkhs.kernels import Array
from rkhs_ros.robot.sensors import SensingError, joint_values

STEPS = ("home", "trigger", "person")
PEAK = 1.5  # greatest speed of a smooth motion, relative to its mean speed


class Joints(NamedTuple):
    """State of joints: positions in rad or m, velocities in rad/s or m/s, each of shape (n,)."""

    position: Array
    velocity: Array


@dataclass(frozen=True)
class Home(Settings):
    """Move to the home position through the gate, and wait until the robot has settled there."""

    topic: str = setting("joint_states", "topic of the JointState messages with the joints' positions and velocities")
    joints: tuple[str, ...] = setting((), "joints in the order of the commands")
    position: tuple[float, ...] = setting((0.0,), "home position of each joint, rad or m", minimum=-1e6, maximum=1e6)
    speed: tuple[float, ...] = setting(
        (0.5,), "greatest speed on the path home, rad/s or m/s", minimum=1e-6, maximum=1e6
    )
    stiffness: tuple[float, ...] = setting(
        (1.0,), "velocity and effort commands: gain per rad or m of position error", minimum=0.0, maximum=1e6
    )
    damping: tuple[float, ...] = setting(
        (1.0,), "effort commands: gain per rad/s or m/s of velocity error", minimum=0.0, maximum=1e6
    )
    tolerance: tuple[float, ...] = setting((0.05,), "accepted distance from home, rad or m", minimum=0.0, maximum=1e6)
    rest: tuple[float, ...] = setting((0.05,), "greatest speed at rest, rad/s or m/s", minimum=0.0, maximum=1e6)
    settle: float = setting(0.2, "seconds for which the robot must stay home and at rest", minimum=0.0, maximum=3600.0)
    timeout: float = setting(30.0, "seconds after which the episode is discarded", minimum=0.01, maximum=3600.0)

    def __post_init__(self) -> None:
        """Raise ValueError if a setting is neither one number nor one per joint."""
        super().__post_init__()
        count = max(len(self.joints), 1)
        for name in ("position", "speed", "stiffness", "damping", "tolerance", "rest"):
            size = len(getattr(self, name))
            require(size in (1, count), f"reset.home.{name}", numbers(1, count), size)

    def joints_in(self, message: Any) -> Joints:
        """Return the state of the joints in a JointState message.

        Raises:
            SensingError: a joint, or its position or velocity, is missing or not finite.
        """
        position, velocity = (np.array(joint_values(message, f, self.joints)) for f in ("position", "velocity"))
        if not np.isfinite([position, velocity]).all():
            raise SensingError(f"{self.topic}: expected finite positions and velocities, got {position}, {velocity}")
        return Joints(position, velocity)


@dataclass(frozen=True)
class Trigger(Settings):
    """Call a service of the user that prepares the scene."""

    service: str = setting("", "name of a service of type std_srvs/srv/Trigger")
    timeout: float = setting(60.0, "seconds after which the episode is discarded", minimum=0.01, maximum=3600.0)


@dataclass(frozen=True)
class Reset(Settings):
    """The reset before each episode; without steps there is none."""

    steps: tuple[str, ...] = setting((), "steps of the reset before each episode, in this order", choices=STEPS)
    home: Home = Home()
    trigger: Trigger = Trigger()

    def __post_init__(self) -> None:
        """Raise ValueError if a setting that a step requires is missing."""
        super().__post_init__()
        require("home" not in self.steps or bool(self.home.joints), "reset.home.joints", "names of joints", "none")
        needs = "trigger" in self.steps and not self.trigger.service
        require(not needs, "reset.trigger.service", "the name of a service", "none")


@dataclass(frozen=True)
class HomingPath:
    """A smooth path between two positions, at rest at both ends.

    Attributes:
        begin: start time, monotonic, seconds.
        start: start position, shape (n,).
        end: end position, shape (n,).
        seconds: duration.
    """

    begin: float
    start: Array
    end: Array
    seconds: float

    @classmethod
    def home(cls, home: Home, start: Array, now: float) -> HomingPath:
        """Return the path home, on which no joint exceeds its speed limit."""
        end = np.broadcast_to(home.position, start.shape)
        seconds = PEAK * float((np.abs(end - start) / np.array(home.speed)).max())
        return cls(now, start, end, max(seconds, 1e-9))

    def at(self, now: float) -> Joints:
        """Return the desired positions and velocities, from a cubic in time."""
        done = min(max((now - self.begin) / self.seconds, 0.0), 1.0)
        share, rate = done * done * (3 - 2 * done), 6 * done * (1 - done) / self.seconds
        return Joints(self.start + share * (self.end - self.start), rate * (self.end - self.start))


def homing_command(home: Home, kind: str, wanted: Joints, found: Joints) -> Array:
    """Return the command that follows the path: the desired position, or feedback on the measured state."""
    off = np.array(home.stiffness) * (wanted.position - found.position)
    match kind:
        case "position":
            return wanted.position
        case "velocity":
            return wanted.velocity + off
        case _:
            return off + np.array(home.damping) * (wanted.velocity - found.velocity)


class Move(NamedTuple):
    """Send a command to the robot."""

    command: Array


class CallService(NamedTuple):
    """Call a service, once."""

    service: str


class Wait(NamedTuple):
    """Wait; if ``text`` is not empty, it tells the operator what to do meanwhile."""

    text: str = ""


class Done(NamedTuple):
    """The reset succeeded."""


class Failed(NamedTuple):
    """The reset failed; the reason says why."""

    reason: str


Outcome = Move | CallService | Wait | Done | Failed


@dataclass(frozen=True)
class Answer:
    """Response of a service."""

    success: bool
    message: str


class ResetProcess:
    """One running reset.

    Owns the current step and its state. Owns no clock.

    Args:
        reset: its settings.
        kind: of the robot's commands.
        confirmation: command line with which the operator confirms that the scene is ready.
        now: monotonic time, seconds.

    Attributes:
        answer: response of the called service; None until it arrives.
        is_confirmed: whether the operator has confirmed that the scene is ready since being asked.
    """

    def __init__(self, reset: Reset, kind: str, confirmation: str, now: float) -> None:
        self.answer: Answer | None = None
        self.is_confirmed = False
        self._reset = reset
        self._kind = kind
        self._confirmation = confirmation
        self._left = list(reset.steps)
        self._since = now
        self._way: HomingPath | None = None
        self._still_since: float | None = None
        self._asked = False

    def proceed(self, now: float, sense: Callable[[], Joints]) -> Outcome:
        """Return the next thing to do.

        Args:
            now: monotonic time, seconds.
            sense: reads the state of the joints, if a step needs it; may raise SensingError.
        """
        while self._left:
            outcome = self._step(self._left[0], now, sense)
            if not isinstance(outcome, Done):
                return outcome
            self._left.pop(0)
            self._since, self._asked, self.answer, self.is_confirmed = now, False, None, False
        return Done()

    def _step(self, name: str, now: float, sense: Callable[[], Joints]) -> Outcome:
        match name:
            case "home":
                try:
                    return self._home(now, sense())
                except SensingError as error:
                    return Failed(f"home: {error}")
            case "trigger":
                return self._trigger(now)
            case _:
                return self._person()

    def _home(self, now: float, found: Joints) -> Outcome:
        home = self._reset.home
        if self._way is None:
            self._way = HomingPath.home(home, found.position, now)
        off = np.abs(found.position - self._way.end)
        there = now >= self._way.begin + self._way.seconds and bool((off <= home.tolerance).all())
        still = there and bool((np.abs(found.velocity) <= home.rest).all())
        self._still_since = (now if self._still_since is None else self._still_since) if still else None
        if self._still_since is not None and now - self._still_since >= home.settle:
            return Done()
        if now - self._since > home.timeout:
            worst = int(off.argmax())
            error = f"{home.joints[worst]} is {off[worst]:.3g} from home"
            return Failed(f"home: not settled within {home.timeout:g} s; {error}")
        return Move(homing_command(home, self._kind, self._way.at(now), found))

    def _trigger(self, now: float) -> Outcome:
        service, timeout = self._reset.trigger.service, self._reset.trigger.timeout
        if self.answer is not None:
            return Done() if self.answer.success else Failed(f"{service} failed: {self.answer.message}")
        if now - self._since > timeout:
            return Failed(f"{service} did not answer within {timeout:g} s")
        asked, self._asked = self._asked, True
        return Wait() if asked else CallService(service)

    def _person(self) -> Outcome:
        asked, self._asked = self._asked, True
        if asked and self.is_confirmed:
            return Done()
        if not asked:
            self.is_confirmed = False  # ignore a confirmation from before the question
        return Wait(f"prepare the scene, then run: {self._confirmation}")
