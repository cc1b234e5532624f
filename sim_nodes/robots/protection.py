"""The protective stop: latched, until it is reset, with each violation that it saw counted by its kind."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

SECOND_PUBLISHER, COMMAND_TIMEOUT = "second_publisher", "command_timeout"  # kinds that every robot has
TOLERANCE = 1e-6  # part of a limit by which it may be passed: what keeps to it exactly is rounded on its way


@dataclass(frozen=True)
class Protection:
    """What a robot's own supervision saw.

    Attributes:
        counts: number of violations since the robot began, by kind.
        reason: why the robot is stopped; empty while it is not.
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
        """Return what it is after one more violation: stopped, for the reason of the first one."""
        counts = {**self.counts, kind: self.counts.get(kind, 0) + 1}
        return Protection(counts, self.reason or f"{kind}: {reason}")

    def reset(self) -> Protection:
        """Return what it is once the stop is reset; the counts stay."""
        return Protection(self.counts)


def exceeds(value: float, limit: float) -> bool:
    """Return whether a magnitude passes a limit by more than rounding."""
    return not abs(value) <= limit * (1.0 + TOLERANCE)
