"""The protective stop, which latches until it is reset and counts violations by kind."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

SECOND_PUBLISHER, COMMAND_TIMEOUT = "second_publisher", "command_timeout"  # kinds of every robot
TOLERANCE = 1e-6  # relative tolerance of limits, because values at a limit are rounded


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
