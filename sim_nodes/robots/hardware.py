"""A simulated robot over time: fixed physics steps, and delayed and lossy communication."""

import math
from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Generic, TypeVar

import numpy as np

from rkhs_ros.policies.streams import stream
from sim_nodes.robots.robot import COMMAND_TIMEOUT, Robot

T = TypeVar("T")

MOST_CATCH_UP_S = 1.0  # of the robot's time per call, so that messages are handled in between


class Wire(Generic[T]):
    """One direction of a connection, which delays or loses messages and preserves their order.

    Owns its random stream, the messages in transit and the number of lost ones. The fate of the k-th message depends
    only on the stream and k.

    Args:
        stream: source of two random numbers per message.
        latency: least delay, seconds.
        jitter: greatest additional delay, uniformly distributed, seconds.
        loss: probability that a message is lost.
    """

    def __init__(self, stream: np.random.Generator, latency: float, jitter: float, loss: float) -> None:
        self.lost = 0
        self._stream = stream
        self._latency, self._jitter, self._loss = latency, jitter, loss
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


@dataclass(frozen=True)
class Sample:
    """One sample of the sensors.

    Attributes:
        time: of the sample, in seconds of the robot's time.
        readings: of the robot.
    """

    time: float
    readings: Any


class Hardware:
    """A robot with its communication, advanced to a given time step by step.

    Owns the robot, the wires, and the numbers of steps and received commands. It has no clock; the caller passes the
    time.

    Args:
        robot: the robot.
    """

    def __init__(self, robot: Robot[Any]) -> None:
        self.robot = robot
        self.steps = self.commands = 0
        self._readings = 0
        self._settings = s = robot.settings
        self._heard_at = -math.inf
        self._commands, self._samples = (
            Wire[Any](stream(s.seed, name, 0), s.latency, s.jitter, s.loss) for name in ("commands", "samples")
        )

    @property
    def time(self) -> float:
        """Seconds of the robot's time up to the last step."""
        return self.steps / self._settings.rate

    @property
    def since_command(self) -> float:
        """Seconds since the last command arrived; infinity before the first one."""
        return self.time - self._heard_at

    def send(self, time: float, command: Any) -> None:
        """Send a command to the robot."""
        self._commands.send(time, command)

    def advance(self, time: float) -> list[Sample]:
        """Advance the robot to a time in seconds, or part of the way; return the samples that have arrived."""
        now = min(time, self.time + MOST_CATCH_UP_S)
        for arrival, command in self._commands.arrived(now):
            self._simulate(arrival)
            self.commands += 1
            self._heard_at = arrival
            self.robot.hear(command)
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
            "seconds since the last command": f"{self.since_command:.3f}",
        }

    @property
    def _next_sample(self) -> float:
        """Time of the next sample, which is taken at the end of the first step at or after it, seconds."""
        return (self._readings + 1) / self._settings.sensor_rate

    def _simulate(self, until: float) -> None:
        while (self.steps + 1) / self._settings.rate <= until:
            self.robot.step()
            self.steps += 1
            self._check_timeout()
            if self.time >= self._next_sample:
                self._readings += 1
                self._samples.send(self.time, Sample(self.time, self.robot.sample()))

    def _check_timeout(self) -> None:
        timeout = self._settings.command_timeout
        if timeout and self.robot.state.is_driven and self.since_command > timeout:
            self.robot.trip(COMMAND_TIMEOUT, f"expected a command every {timeout:g} s")
