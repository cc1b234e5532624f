"""Base classes of simulated robots: settings, state with a protective stop, and readings of joints."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Generic, NamedTuple, Protocol, Self, TypeVar

from rkhs_ros.base.settings import Settings, setting
from rkhs_ros.base.validation import require

SECOND_PUBLISHER, COMMAND_TIMEOUT = "second_publisher", "command_timeout"  # kinds of every robot
TOLERANCE = 1e-6  # relative tolerance of limits, because values at a limit are rounded


class JointReadings(NamedTuple):
    """Readings of all joints at one time, as in `sensor_msgs/JointState`.

    Attributes:
        names: of the joints.
        positions: rad.
        velocities: rad/s.
        efforts: N m.
    """

    names: tuple[str, ...]
    positions: tuple[float, ...]
    velocities: tuple[float, ...]
    efforts: tuple[float, ...]


@dataclass(frozen=True)
class Protection:
    """State of a robot's protective stop.

    Attributes:
        counts: number of violations since the robot started, by kind.
        reason: why the robot is stopped; empty if it is not.
    """

    counts: Mapping[str, int] = field(default_factory=dict)
    reason: str = ""

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
