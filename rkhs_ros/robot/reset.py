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
Numbers = tuple[float, ...]
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
    position: Numbers = setting((0.0,), "home position of each joint, rad or m", minimum=-1e6, maximum=1e6)
    speed: Numbers = setting((0.5,), "greatest speed on the path home, rad/s or m/s", minimum=1e-6, maximum=1e6)
    stiffness: Numbers = setting(
        (1.0,), "velocity and effort commands: gain per rad or m of position error", minimum=0.0, maximum=1e6
    )
    damping: Numbers = setting(
        (1.0,), "effort commands: gain per rad/s or m/s of velocity error", minimum=0.0, maximum=1e6
    )
    tolerance: Numbers = setting((0.05,), "accepted distance from home, rad or m", minimum=0.0, maximum=1e6)
    rest: Numbers = setting((0.05,), "greatest speed at rest, rad/s or m/s", minimum=0.0, maximum=1e6)
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


class ResetError(Exception):
    """A reset failed; the message is one line."""


def path_home(home: Home, start: Array, elapsed: float) -> tuple[Joints, bool]:
    """Return the desired state on a smooth path home, at rest at both ends, and whether the path has ended.

    The path is cubic in time, and no joint exceeds its speed limit.

    Args:
        home: the settings of the motion.
        start: start position, shape (n,).
        elapsed: seconds since the start.
    """
    way = np.broadcast_to(home.position, start.shape) - start
    seconds = max(PEAK * float((np.abs(way) / np.array(home.speed)).max()), 1e-9)
    done = min(elapsed / seconds, 1.0)
    share, rate = done * done * (3 - 2 * done), 6 * done * (1 - done) / seconds
    return Joints(start + share * way, rate * way), done == 1.0


class ResetProcess:
    """One running reset.

    Owns the remaining steps, and the progress of the current one.

    Args:
        reset: the steps and their settings.
        kind: quantity that a command sets.
        confirmation: commands with which the operator confirms that the scene is ready.
        now: monotonic time of the start, seconds.
        call: calls the service of the step ``trigger``.

    Attributes:
        answer: success and message of the service; None until they arrive.
        is_confirmed: whether the operator has confirmed that the scene is ready since being asked.
    """

    def __init__(self, reset: Reset, kind: str, confirmation: str, now: float, call: Callable[[], None]) -> None:
        self.answer: tuple[bool, str] | None = None
        self.is_confirmed = False
        self._reset = reset
        self._kind = kind
        self._confirmation = confirmation
        self._call = call
        self._left = list(reset.steps)
        self._since = now
        self._start: tuple[float, Array] | None = None  # of the path home: monotonic time and position
        self._still_since: float | None = None
        self._asked = False

    def proceed(self, now: float, sense: Callable[[], Joints]) -> Array | str | None:
        """Return the next command, or what the operator has to do meanwhile ("" for nothing), or None at the end.

        Args:
            now: monotonic time, seconds.
            sense: reads the state of the joints, if a step needs it; may raise SensingError.

        Raises:
            ResetError: a step failed.
        """
        while self._left:
            outcome = self._step(self._left[0], now, sense)
            if outcome is not None:
                return outcome
            self._left.pop(0)
            self._since, self._asked, self.answer, self.is_confirmed = now, False, None, False
        return None

    def _step(self, name: str, now: float, sense: Callable[[], Joints]) -> Array | str | None:
        match name:
            case "home":
                try:
                    return self._home(now, sense())
                except SensingError as error:
                    raise ResetError(f"home: {error}") from error
            case "trigger":
                return self._trigger(now)
            case _:
                return self._person()

    def _home(self, now: float, found: Joints) -> Array | None:
        home = self._reset.home
        self._start = self._start or (now, found.position)
        wanted, there = path_home(home, self._start[1], now - self._start[0])
        off = np.abs(found.position - home.position)
        still = there and bool((off <= home.tolerance).all() and (np.abs(found.velocity) <= home.rest).all())
        self._still_since = (now if self._still_since is None else self._still_since) if still else None
        if self._still_since is not None and now - self._still_since >= home.settle:
            return None
        if now - self._since > home.timeout:
            worst = int(off.argmax())
            error = f"{home.joints[worst]} is {off[worst]:.3g} from home"
            raise ResetError(f"home: not settled within {home.timeout:g} s; {error}")
        pull = np.array(home.stiffness) * (wanted.position - found.position)
        match self._kind:
            case "position":
                return wanted.position
            case "velocity":
                return wanted.velocity + pull
            case _:
                return pull + np.array(home.damping) * (wanted.velocity - found.velocity)

    def _trigger(self, now: float) -> str | None:
        service, timeout = self._reset.trigger.service, self._reset.trigger.timeout
        if self.answer is not None:
            success, message = self.answer
            if not success:
                raise ResetError(f"{service} failed: {message}")
            return None
        if now - self._since > timeout:
            raise ResetError(f"{service} did not answer within {timeout:g} s")
        if not self._asked:
            self._asked = True
            self._call()
        return ""

    def _person(self) -> str | None:
        asked, self._asked = self._asked, True
        if asked and self.is_confirmed:
            return None
        if not asked:
            self.is_confirmed = False  # ignore a confirmation from before the question
        return f"prepare the scene, then run: {self._confirmation}"
