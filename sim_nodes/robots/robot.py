"""Base classes of simulated robots."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Any, Generic, Protocol, Self, TypeVar

from rkhs_ros.base.settings import Settings, setting
from rkhs_ros.base.validation import require
from sim_nodes.robots.protection import Protection


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
    command_timeout: float = setting(
        0.0,
        "seconds without a command after which the robot makes a protective stop; 0 for never",
        minimum=0.0,
        maximum=60.0,
    )

    def __post_init__(self) -> None:
        """Raise ValueError if settings are inconsistent."""
        super().__post_init__()
        require(self.sensor_rate <= self.rate, "sensor_rate", f"at most the rate, {self.rate:g}", self.sensor_rate)


class State(Protocol):
    """The state of a robot, an immutable value."""

    @property
    def protection(self) -> Protection:
        """State of the protective stop."""

    @property
    def is_driven(self) -> bool:
        """Whether the motors are on: a command turns them on, and a protective stop turns them off."""

    def tripped(self, kind: str, reason: str) -> Self:
        """Return the state after a violation."""

    def reset(self) -> Self:
        """Return the state with the protective stop reset; the brakes hold until the next command."""


AnyState = TypeVar("AnyState", bound=State)


class Robot(ABC, Generic[AnyState]):
    """A simulated robot, advanced in steps of its physics.

    Owns its state.

    Args:
        settings: of the robot.
        state: initial state.
    """

    def __init__(self, settings: RobotSettings, state: AnyState) -> None:
        self.settings = settings
        self.state = state

    @abstractmethod
    def hear(self, command: Any) -> None:
        """Receive a command."""

    @abstractmethod
    def step(self) -> None:
        """Simulate one step of the physics."""

    @abstractmethod
    def sample(self) -> Any:
        """Return the readings of the sensors."""

    @abstractmethod
    def description(self) -> str:
        """Return the robot's URDF."""

    def trip(self, kind: str, reason: str) -> None:
        """Make a protective stop for a violation."""
        self.state = self.state.tripped(kind, reason)

    def reset(self) -> None:
        """Reset the protective stop."""
        self.state = self.state.reset()
