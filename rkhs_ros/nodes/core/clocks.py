"""Conversion between the monotonic clock and the system clock."""

import time

READINGS = 10  # attempts; the fastest counts, because the process may be preempted between the two clocks
QUICK_S = 2e-5  # duration of a reading without preemption


def now_by_both_clocks() -> tuple[float, int]:
    """Return the monotonic time in seconds and the system time in nanoseconds, read as simultaneously as possible."""
    best = (float("inf"), 0.0, 0)  # duration of the reading in seconds, and both times
    for _ in range(READINGS):
        before, system_ns, after = time.monotonic(), time.time_ns(), time.monotonic()
        best = min(best, (after - before, (before + after) / 2, system_ns))
        if best[0] <= QUICK_S:
            break
    return best[1:]
