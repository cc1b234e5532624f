"""Resets: how a robot comes to where its episodes begin, step by step."""

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
    """Where joints are: positions in radians or metres, velocities per second, shape (n,) each."""

    position: Array
    velocity: Array


@dataclass(frozen=True)
class Home(Settings):
    """Move to the home position through the gate, and wait until the robot has settled there."""

    topic: str = setting("joint_states", "topic of the JointState messages that tell where the joints are")
    joints: tuple[str, ...] = setting((), "joints in the order of the commands")
    position: tuple[float, ...] = setting((0.0,), "home position of each joint, rad or m", minimum=-1e6, maximum=1e6)
    speed: tuple[float, ...] = setting((0.5,), "greatest speed of the way, rad/s or m/s", minimum=1e-6, maximum=1e6)
    stiffness: tuple[float, ...] = setting(
        (1.0,), "for velocity and effort commands: per rad or m off the way", minimum=0.0, maximum=1e6
    )
    damping: tuple[float, ...] = setting(
        (1.0,), "for effort commands: per rad/s or m/s off the speed of the way", minimum=0.0, maximum=1e6
    )
    tolerance: tuple[float, ...] = setting((0.05,), "distance from home that is near enough", minimum=0.0, maximum=1e6)
    rest: tuple[float, ...] = setting((0.05,), "speed that counts as rest, rad/s or m/s", minimum=0.0, maximum=1e6)
    settle: float = setting(0.2, "seconds at home and at rest", minimum=0.0, maximum=3600.0)
    timeout: float = setting(30.0, "seconds after which the episode is void", minimum=0.01, maximum=3600.0)

    def __post_init__(self) -> None:
        """Raise ValueError where a setting is neither one number nor one for each joint."""
        super().__post_init__()
        count = max(len(self.joints), 1)
        for name in ("position", "speed", "stiffness", "damping", "tolerance", "rest"):
            size = len(getattr(self, name))
            require(size in (1, count), f"reset.home.{name}", numbers(1, count), size)

    def joints_in(self, message: Any) -> Joints:
        """Return where the joints are by a JointState.

        Raises:
            SensingError: a joint, or its position or velocity, is not in it, or not finite.
        """
        position, velocity = (np.array(joint_values(message, f, self.joints)) for f in ("position", "velocity"))
        if not np.isfinite([position, velocity]).all():
            raise SensingError(f"{self.topic}: expected finite positions and velocities, got others")
        return Joints(position, velocity)


@dataclass(frozen=True)
class Trigger(Settings):
    """Call a service of the user's, which brings the scene into order."""

    service: str = setting("", "name of a service of type std_srvs/srv/Trigger")
    timeout: float = setting(60.0, "seconds after which the episode is void", minimum=0.01, maximum=3600.0)


@dataclass(frozen=True)
class Reset(Settings):
    """What is done before each episode, in order; nothing where there are no steps."""

    steps: tuple[str, ...] = setting((), "what is done before each episode, in this order", choices=STEPS)
    home: Home = Home()
    trigger: Trigger = Trigger()

    def __post_init__(self) -> None:
        """Raise ValueError where what a step needs is missing."""
        super().__post_init__()
        require("home" not in self.steps or bool(self.home.joints), "reset.home.joints", "names of joints", "none")
        needs = "trigger" in self.steps and not self.trigger.service
        require(not needs, "reset.trigger.service", "the name of a service", "none")


@dataclass(frozen=True)
class Way:
    """A smooth motion from a position to another, at rest at both ends.

    Attributes:
        begin: monotonic time, seconds.
        start: shape (n,).
        end: shape (n,).
        seconds: how long it takes.
    """

    begin: float
    start: Array
    end: Array
    seconds: float

    @classmethod
    def home(cls, home: Home, start: Array, now: float) -> Way:
        """Return the way home, on which no joint is faster than it may be."""
        end = np.broadcast_to(home.position, start.shape)
        seconds = PEAK * float((np.abs(end - start) / np.array(home.speed)).max())
        return cls(now, start, end, max(seconds, 1e-9))

    def at(self, now: float) -> Joints:
        """Return where the joints should be, and how fast, by a cubic in time."""
        done = min(max((now - self.begin) / self.seconds, 0.0), 1.0)
        share, rate = done * done * (3 - 2 * done), 6 * done * (1 - done) / self.seconds
        return Joints(self.start + share * (self.end - self.start), rate * (self.end - self.start))


def homing_command(home: Home, kind: str, wanted: Joints, found: Joints) -> Array:
    """Return the command that keeps joints to their way: the position wanted, or a feedback on what was found."""
    off = np.array(home.stiffness) * (wanted.position - found.position)
    match kind:
        case "position":
            return wanted.position
        case "velocity":
            return wanted.velocity + off
        case _:
            return off + np.array(home.damping) * (wanted.velocity - found.velocity)


class Move(NamedTuple):
    """The robot is to be sent a command."""

    command: Array


class Ask(NamedTuple):
    """A service is to be called, once."""

    service: str


class Wait(NamedTuple):
    """Nothing is to be done but wait; for a person where there is a text that says what for."""

    text: str = ""


class Done(NamedTuple):
    """The robot is where episodes begin."""


class Failed(NamedTuple):
    """The reset did not come to its end; the reason says why."""

    reason: str


Outcome = Move | Ask | Wait | Done | Failed


@dataclass(frozen=True)
class Answer:
    """What a service answered."""

    success: bool
    message: str


class Resetting:
    """One reset as it goes.

    Owns the step it is at, since when, and what that step must remember. Does not own any clock.

    Args:
        reset: its steps.
        kind: of the robot's commands.
        word: what a person types to say that the scene is in order.
        now: monotonic time, seconds.

    Attributes:
        answer: what the service that was to be called answered; None until it did.
        word_given: whether a person said that the scene is in order, since that was asked for.
    """

    def __init__(self, reset: Reset, kind: str, word: str, now: float) -> None:
        self.answer: Answer | None = None
        self.word_given = False
        self._reset = reset
        self._kind = kind
        self._word = word
        self._left = list(reset.steps)
        self._since = now
        self._way: Way | None = None
        self._still_since: float | None = None
        self._asked = False

    def proceed(self, now: float, sense: Callable[[], Joints]) -> Outcome:
        """Return what is to be done next.

        Args:
            now: monotonic time, seconds.
            sense: returns where the joints are; called by the steps that need it. May raise SensingError.
        """
        while self._left:
            outcome = self._step(self._left[0], now, sense)
            if not isinstance(outcome, Done):
                return outcome
            self._left.pop(0)
            self._since, self._asked, self.answer, self.word_given = now, False, None, False
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
            self._way = Way.home(home, found.position, now)
        off = np.abs(found.position - self._way.end)
        there = now >= self._way.begin + self._way.seconds and bool((off <= home.tolerance).all())
        still = there and bool((np.abs(found.velocity) <= home.rest).all())
        self._still_since = (now if self._still_since is None else self._still_since) if still else None
        if self._still_since is not None and now - self._still_since >= home.settle:
            return Done()
        if now - self._since > home.timeout:
            worst = int(off.argmax())
            return Failed(f"home: not settled within {home.timeout:g} s; {home.joints[worst]} is {off[worst]:.3g} off")
        return Move(homing_command(home, self._kind, self._way.at(now), found))

    def _trigger(self, now: float) -> Outcome:
        service, timeout = self._reset.trigger.service, self._reset.trigger.timeout
        if self.answer is not None:
            return Done() if self.answer.success else Failed(f"{service} did not succeed: {self.answer.message}")
        if now - self._since > timeout:
            return Failed(f"{service} did not answer within {timeout:g} s")
        asked, self._asked = self._asked, True
        return Wait() if asked else Ask(service)

    def _person(self) -> Outcome:
        asked, self._asked = self._asked, True
        if asked and self.word_given:
            return Done()
        if not asked:
            self.word_given = False  # a word that came before it was asked for counts for nothing
        return Wait(f"bring the scene into order, then: {self._word}")
