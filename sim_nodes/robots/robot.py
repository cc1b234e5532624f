"""Simulated robots over time: settings, protective stop, fixed physics steps, delayed and lossy communication."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any, Generic, NamedTuple, TypeVar

import numpy as np

from rkhs_ros.base.settings import Settings, setting
from rkhs_ros.base.validation import require
from rkhs_ros.policies.streams import stream

T = TypeVar("T")

SECOND_PUBLISHER = "second_publisher"  # a kind of every robot
MOST_CATCH_UP_S = 1.0  # of the robot's time per call, so that messages are handled in between
TOLERANCE = 1e-6  # relative tolerance of limits, because values at a limit are rounded


class JointReadings(NamedTuple):
    """Readings of all joints at one time, as in `sensor_msgs/JointState`, in rad, rad/s and N m."""

    names: tuple[str, ...]
    positions: tuple[float, ...]
    velocities: tuple[float, ...]
    efforts: tuple[float, ...]


@dataclass(frozen=True)
class Protection:
    """State of a robot's protective stop."""

    counts: Mapping[str, int] = field(default_factory=dict)  # violations since the robot started, by kind
    reason: str = ""  # why the robot is stopped; empty if it is not

    @property
    def is_stopped(self) -> bool:
        """Whether the robot is stopped."""
        return bool(self.reason)

    @property
    def violations(self) -> int:
        """Number of violations of all kinds."""
        return sum(self.counts.values())

    def tripped(self, kind: str, reason: str) -> Protection:
        """Return the state after another violation: stopped, with the reason of the first one."""
        counts = {**self.counts, kind: self.counts.get(kind, 0) + 1}
        return Protection(counts, self.reason or f"{kind}: {reason}")

    def reset(self) -> Protection:
        """Return the state after a reset; the counts are preserved."""
        return Protection(self.counts)


def exceeds(value: float, limit: float) -> bool:
    """Return whether a magnitude exceeds a limit by more than rounding."""
    return not abs(value) <= limit * (1.0 + TOLERANCE)


@dataclass(frozen=True)
class RobotSettings(Settings):
    """Settings of all simulated robots.

    All times and rates are in the robot's time, which runs `speed` times as fast as real time.
    """

    seed: int = setting(0, "seed of noise, delays and losses", minimum=0, maximum=2**63 - 1)
    speed: float = setting(1.0, "speed of the robot's time relative to real time", minimum=0.01, maximum=1000.0)
    rate: float = setting(500.0, "rate of the physics, Hz", minimum=1.0, maximum=10_000.0)
    sensor_rate: float = setting(200.0, "rate of joint states, Hz; at most `rate`", minimum=1.0, maximum=10_000.0)
    latency: float = setting(0.002, "least delay of a message, each way, s", minimum=0.0, maximum=10.0)
    jitter: float = setting(0.002, "greatest additional delay of a message, each way, s", minimum=0.0, maximum=10.0)
    loss: float = setting(0.0, "probability that a message is lost, each way", minimum=0.0, maximum=0.99)
    position_noise: float = setting(1e-3, "sd of the noise of positions, rad", minimum=0.0, maximum=1.0)
    velocity_noise: float = setting(1e-2, "sd of the noise of velocities, rad/s", minimum=0.0, maximum=10.0)

    def __post_init__(self) -> None:
        """Raise ValueError if settings are inconsistent."""
        super().__post_init__()
        require(self.sensor_rate <= self.rate, "sensor_rate", f"at most the rate, {self.rate:g}", self.sensor_rate)


class Robot(ABC):
    """A simulated robot, advanced in steps of its physics.

    Owns its state, an immutable value: its ``protection``, and the states after a command (``heard``), after a
    violation (``tripped``) and after a reset of the protective stop (``reset``).
    """

    def __init__(self, settings: RobotSettings, state: Any) -> None:
        self.settings = settings
        self.state = state

    @abstractmethod
    def step(self) -> None:
        """Simulate one step of the physics."""

    @abstractmethod
    def sample(self) -> Any:
        """Return the readings of the sensors."""

    @abstractmethod
    def description(self) -> str:
        """Return the robot's URDF."""


class Wire(Generic[T]):
    """One direction of a connection, which delays or loses messages and preserves their order.

    Owns its random stream, the messages in transit and the number of lost ones. The fate of the k-th message depends
    only on the stream and k. Latency and jitter are in seconds.
    """

    def __init__(self, stream: np.random.Generator, latency: float, jitter: float, loss: float) -> None:
        self.lost = 0
        self._stream, self._latency, self._jitter, self._loss = stream, latency, jitter, loss
        self._under_way: deque[tuple[float, T]] = deque()
        self._last_arrival = -math.inf

    @property
    def next_arrival(self) -> float:
        """Arrival time of the next message, seconds; infinity if none is in transit."""
        return self._under_way[0][0] if self._under_way else math.inf

    def send(self, time: float, message: T) -> None:
        """Send a message at the given time in seconds; it may be lost."""
        fate, delay = self._stream.random(2)
        if fate < self._loss:
            self.lost += 1
            return
        self._last_arrival = max(self._last_arrival, time + self._latency + self._jitter * delay)
        self._under_way.append((self._last_arrival, message))

    def arrived(self, time: float) -> Iterator[tuple[float, T]]:
        """Remove and yield the messages that have arrived by a time, each with its arrival time."""
        while self._under_way and self.next_arrival <= time:
            yield self._under_way.popleft()


class Hardware:
    """A robot with its communication, advanced to a given time step by step.

    Owns the robot, the wires, and the numbers of steps and received commands. The caller passes the time.
    """

    def __init__(self, robot: Robot) -> None:
        self.robot = robot
        self.steps = self.commands = 0
        self._readings = 0
        self._settings = s = robot.settings
        self._commands, self._samples = (
            Wire[Any](stream(s.seed, name, 0), s.latency, s.jitter, s.loss) for name in ("commands", "samples")
        )

    @property
    def time(self) -> float:
        """Seconds of the robot's time up to the last step."""
        return self.steps / self._settings.rate

    def send(self, time: float, command: Any) -> None:
        """Send a command to the robot."""
        self._commands.send(time, command)

    def advance(self, time: float) -> list[tuple[float, Any]]:
        """Advance the robot to a time in seconds, or part of the way; return the samples that have arrived by then."""
        now = min(time, self.time + MOST_CATCH_UP_S)
        for arrival, command in self._commands.arrived(now):
            self._simulate(arrival)
            self.commands += 1
            self.robot.state = self.robot.state.heard(command)
        self._simulate(now)
        return [sample for _, sample in self._samples.arrived(now)]

    def next_event(self) -> float:
        """Return the time of the next event: a sample, or the arrival of a message."""
        return min(self._next_sample, self._commands.next_arrival, self._samples.next_arrival)

    def report(self) -> dict[str, object]:
        """Return the violations by kind, and the counters of commands, samples and steps."""
        protection = self.robot.state.protection
        return {
            "stopped": protection.is_stopped,
            "violations": protection.violations,
            **protection.counts,
            "commands": self.commands,
            "commands lost": self._commands.lost,
            "samples lost": self._samples.lost,
            "steps": self.steps,
        }

    @property
    def _next_sample(self) -> float:
        """Time of the next sample, which is taken at the end of the first step at or after it, seconds."""
        return (self._readings + 1) / self._settings.sensor_rate

    def _simulate(self, until: float) -> None:
        while (self.steps + 1) / self._settings.rate <= until:
            self.robot.step()
            self.steps += 1
            if self.time >= self._next_sample:
                self._readings += 1
                self._samples.send(self.time, (self.time, self.robot.sample()))
