"""The elastic clock of a robot's steps."""

from __future__ import annotations

from dataclasses import dataclass, replace

SLACK = 0.1  # fraction of the period by which a tick may be late without shifting the ticks after it


@dataclass(frozen=True)
class ElasticClock:
    """A periodic clock that tolerates late ticks.

    A slightly late tick does not shift later ticks, which preserves the mean period. A very late tick shifts all later
    ticks: otherwise the next step would be too short, and its action would act for less time than the policy expects.

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
    """Durations of the steps of a robot.

    Attributes:
        steps: number of steps.
        seconds: total duration.
        worst: duration of the longest step, seconds.
    """

    steps: int = 0
    seconds: float = 0.0
    worst: float = 0.0

    def with_step(self, seconds: float) -> StepTiming:
        """Return the timing with one more step."""
        return StepTiming(self.steps + 1, self.seconds + seconds, max(self.worst, seconds))

    def __add__(self, other: StepTiming) -> StepTiming:
        """Return the timing of the steps of both."""
        return StepTiming(self.steps + other.steps, self.seconds + other.seconds, max(self.worst, other.worst))

    @property
    def mean(self) -> float:
        """Mean duration of a step, seconds; 0 before the first one."""
        return self.seconds / self.steps if self.steps else 0.0
