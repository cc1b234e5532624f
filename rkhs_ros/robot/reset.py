"""Resets: the steps that bring a robot to the start of an episode."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from math import inf
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
        """Return the state of the joints in a JointState message; raise SensingError if it is incomplete."""
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

    The path is cubic in time, and no joint exceeds its speed. ``start`` has the shape (n,), ``elapsed`` is in seconds.
    """
    way = np.broadcast_to(home.position, start.shape) - start
    seconds = max(PEAK * float((np.abs(way) / np.array(home.speed)).max()), 1e-9)
    done = min(elapsed / seconds, 1.0)
    share, rate = done * done * (3 - 2 * done), 6 * done * (1 - done) / seconds
    return Joints(start + share * way, rate * way), done == 1.0


@dataclass(frozen=True)
class Means:
    """What a reset senses and calls.

    Attributes:
        kind: quantity that a command sets.
        now: returns the monotonic time, seconds.
        sense: returns the state of the joints; may raise SensingError.
        call: calls the service of the step ``trigger``; returns the future of its answer.
        question: what the operator has to do in the step ``person``.
        confirmations: returns how often the operator has confirmed something so far.
    """

    kind: str
    now: Callable[[], float]
    sense: Callable[[], Joints]
    call: Callable[[], Any]
    question: str
    confirmations: Callable[[], int]


def reset_steps(reset: Reset, means: Means) -> Iterator[Array | str]:
    """Yield the next command of a reset, or what the operator has to do meanwhile, "" for nothing, until its end.

    Raises ResetError if a step fails.
    """
    for step in reset.steps:
        if step == "home":
            yield from _go_home(reset.home, means)
        elif step == "trigger":
            yield from _call(reset.trigger, means)
        else:
            before = means.confirmations()
            while means.confirmations() == before:
                yield means.question


def _go_home(home: Home, means: Means) -> Iterator[Array]:
    begin, start, still_since = means.now(), _sensed(means).position, inf
    while True:
        now, found = means.now(), _sensed(means)
        wanted, there = path_home(home, start, now - begin)
        off = np.abs(found.position - home.position)
        still = there and bool((off <= home.tolerance).all() and (np.abs(found.velocity) <= home.rest).all())
        still_since = min(still_since, now) if still else inf
        if now - still_since >= home.settle:
            return
        if now - begin > home.timeout:
            worst = int(off.argmax())
            error = f"{home.joints[worst]} is {off[worst]:.3g} from home"
            raise ResetError(f"home: not settled within {home.timeout:g} s; {error}")
        pull = np.array(home.stiffness) * (wanted.position - found.position)
        if means.kind == "position":
            yield wanted.position
        elif means.kind == "velocity":
            yield wanted.velocity + pull
        else:
            yield pull + np.array(home.damping) * (wanted.velocity - found.velocity)


def _sensed(means: Means) -> Joints:
    try:
        return means.sense()
    except SensingError as error:
        raise ResetError(f"home: {error}") from error


def _call(trigger: Trigger, means: Means) -> Iterator[str]:
    begin, answer = means.now(), means.call()
    while not answer.done():
        if means.now() - begin > trigger.timeout:
            raise ResetError(f"{trigger.service} did not answer within {trigger.timeout:g} s")
        yield ""
    if not answer.result().success:
        raise ResetError(f"{trigger.service} failed: {answer.result().message}")
