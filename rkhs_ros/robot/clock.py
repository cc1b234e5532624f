"""The elastic clock of a robot's steps."""

from __future__ import annotations

from dataclasses import dataclass, replace

SLACK = 0.1  # part of the period by which a tick may be late and the next one still come when it was due


@dataclass(frozen=True)
class ElasticClock:
    """When the next tick is due.

    A tick that is late by little does not shift those after it, so that the mean period is kept. One that is later
    shifts them all: it is not made up for by a short step, in which the robot would not do what it was told for as
    long as the policy has learnt to expect.

    Attributes:
        period: seconds.
        due: monotonic time of the next tick, seconds.
    """

    period: float
    due: float

    def ticked(self, now: float) -> ElasticClock:
        """Return the clock after the tick that was due."""
        return replace(self, due=(now if self.is_late(now) else self.due) + self.period)

    def is_late(self, now: float) -> bool:
        """Return whether a tick now is so late that it shifts those after it."""
        return now - self.due > SLACK * self.period


@dataclass(frozen=True)
class StepTiming:
    """How long steps took.

    Attributes:
        steps: their number.
        seconds: of all of them.
        worst: seconds of the longest one.
    """

    steps: int = 0
    seconds: float = 0.0
    worst: float = 0.0

    def with_step(self, seconds: float) -> StepTiming:
        """Return the pace with one more step."""
        return StepTiming(self.steps + 1, self.seconds + seconds, max(self.worst, seconds))

    def __add__(self, other: StepTiming) -> StepTiming:
        """Return the pace of the steps of both."""
        return StepTiming(self.steps + other.steps, self.seconds + other.seconds, max(self.worst, other.worst))

    @property
    def mean(self) -> float:
        """Mean seconds of a step; 0 before the first one."""
        return self.seconds / self.steps if self.steps else 0.0
