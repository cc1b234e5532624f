"""A simulated robot over time: fixed physics steps, and delayed and lossy communication."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

from rkhs_ros.policies.streams import stream
from sim_nodes.robots.protection import COMMAND_TIMEOUT
from sim_nodes.robots.robot import Robot
from sim_nodes.robots.wire import Wire

MOST_CATCH_UP_S = 1.0  # of the robot's time per call, so that messages are handled in between


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
