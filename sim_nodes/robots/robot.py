"""A simulated robot in steps of its physics."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Any, Generic, Protocol, Self, TypeVar

from rkhs_ros.base.settings import Settings, setting
from rkhs_ros.base.validation import require
from sim_nodes.robots.protection import Protection


@dataclass(frozen=True)
class RobotSettings(Settings):
    """What all simulated robots have.

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


class State(Protocol):
    """The state of a robot: a value."""

    @property
    def protection(self) -> Protection:
        """What its supervision saw."""

    @property
    def is_driven(self) -> bool:
        """Whether its motors are on: since the first command, unless it is stopped."""

    def tripped(self, kind: str, reason: str) -> Self:
        """Return what it is after a violation."""

    def reset(self) -> Self:
        """Return what it is without its protective stop; the brakes hold until the next command."""


AnyState = TypeVar("AnyState", bound=State)


class Robot(ABC, Generic[AnyState]):
    """A robot in steps of its physics.

    Owns its state; each kind says what else.

    Args:
        settings: of it.
        state: that it begins in.
    """

    def __init__(self, settings: RobotSettings, state: AnyState) -> None:
        self.settings = settings
        self.state = state

    @abstractmethod
    def hear(self, command: Any) -> None:
        """Take a command."""

    @abstractmethod
    def step(self) -> None:
        """Move by one step of the physics."""

    @abstractmethod
    def sample(self) -> Any:
        """Return what the sensors read."""

    @abstractmethod
    def description(self) -> str:
        """Return the robot's URDF."""

    def trip(self, kind: str, reason: str) -> None:
        """Stop for a violation."""
        self.state = self.state.tripped(kind, reason)

    def reset(self) -> None:
        """Leave the protective stop."""
        self.state = self.state.reset()
