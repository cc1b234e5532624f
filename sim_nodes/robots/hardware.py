"""A practice robot in time: its physics in fixed steps, its wires, and what it heard."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Protocol

from rkhs_ros.base.settings import Settings, setting
from rkhs_ros.base.validation import require
from rkhs_ros.policies.streams import stream
from sim_nodes.robots.protection import COMMAND_TIMEOUT, Protection
from sim_nodes.robots.wire import Wire

MOST_CATCH_UP_S = 1.0  # of the robot's time that are caught up at once, so that messages are handled in between


@dataclass(frozen=True)
class RobotSettings(Settings):
    """What all practice robots have.

    All times and rates are in the robot's time, which goes `speed` times as fast as the wall's.
    """

    seed: int = setting(0, "of the noise, the delays and the losses", minimum=0, maximum=2**63 - 1)
    speed: float = setting(1.0, "of the robot's time against the wall's", minimum=0.01, maximum=1000.0)
    rate: float = setting(500.0, "steps of the physics, Hz", minimum=1.0, maximum=10_000.0)
    sensor_rate: float = setting(200.0, "joint states, Hz; at most the rate", minimum=1.0, maximum=10_000.0)
    latency: float = setting(0.002, "that each message takes at least, each way, s", minimum=0.0, maximum=10.0)
    jitter: float = setting(0.002, "that a message takes more at most, each way, s", minimum=0.0, maximum=10.0)
    loss: float = setting(0.0, "probability that a message is lost, each way", minimum=0.0, maximum=0.99)
    position_noise: float = setting(1e-3, "sd of a sensed position, rad", minimum=0.0, maximum=1.0)
    velocity_noise: float = setting(1e-2, "sd of a sensed velocity, rad/s", minimum=0.0, maximum=10.0)
    command_timeout: float = setting(
        0.0, "without a command after which the robot stops by itself, s; 0 for never", minimum=0.0, maximum=60.0
    )

    def __post_init__(self) -> None:
        """Raise ValueError where a value does not fit."""
        super().__post_init__()
        require(self.sensor_rate <= self.rate, "sensor_rate", f"at most the rate, {self.rate:g}", self.sensor_rate)


class Robot(Protocol):
    """A robot in steps of its physics; it owns its state."""

    @property
    def settings(self) -> RobotSettings:
        """Of the robot."""

    @property
    def protection(self) -> Protection:
        """What its supervision saw."""

    @property
    def is_driven(self) -> bool:
        """Whether its motors are on: since the first command, unless it is stopped."""

    def hear(self, command: Any) -> None:
        """Take a command."""

    def step(self) -> None:
        """Move by one step of the physics."""

    def sample(self) -> Any:
        """Return what the sensors read."""

    def trip(self, kind: str, reason: str) -> None:
        """Stop for a violation."""

    def reset(self) -> None:
        """Leave the protective stop; the brakes hold until the next command."""


@dataclass(frozen=True)
class Sample:
    """What the sensors read.

    Attributes:
        time: at which they did, in seconds of the robot's time.
        readings: of the robot.
    """

    time: float
    readings: Any


class Hardware:
    """A robot behind wires, moved on to whatever time it is: a late caller has it catch up, step by step.

    Owns the robot, the wires, the number of steps made and of commands heard. Does not own a clock: time is told.

    Args:
        robot: the robot.
    """

    def __init__(self, robot: Robot) -> None:
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
        """Seconds since the last command was heard; infinity where none was."""
        return self.time - self._heard_at

    def send(self, time: float, command: Any) -> None:
        """Send the robot a command."""
        self._commands.send(time, command)

    def advance(self, time: float) -> list[Sample]:
        """Move the robot on to a time in seconds, or some way to it; return the samples that have arrived."""
        now = min(time, self.time + MOST_CATCH_UP_S)
        for arrival, command in self._commands.arrived(now):
            self._simulate(arrival)
            self.commands += 1
            self._heard_at = arrival
            self.robot.hear(command)
        self._simulate(now)
        return [sample for _, sample in self._samples.arrived(now)]

    def next_event(self) -> float:
        """Return when the robot is to be moved on next: to take a sample, or for a message that arrives."""
        return min(self._next_sample, self._commands.next_arrival, self._samples.next_arrival)

    def report(self) -> dict[str, object]:
        """Return the violations by kind, and what was heard and done."""
        protection = self.robot.protection
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
        """When the sensors are read next, by the first step that ends then or later, in seconds."""
        return (self._readings + 1) / self._settings.sensor_rate

    def _simulate(self, until: float) -> None:
        while (self.steps + 1) / self._settings.rate <= until:
            self.robot.step()
            self.steps += 1
            self._look_for_timeout()
            if self.time >= self._next_sample:
                self._readings += 1
                self._samples.send(self.time, Sample(self.time, self.robot.sample()))

    def _look_for_timeout(self) -> None:
        timeout = self._settings.command_timeout
        if timeout and self.robot.is_driven and self.since_command > timeout:
            self.robot.trip(COMMAND_TIMEOUT, f"expected a command every {timeout:g} s")
