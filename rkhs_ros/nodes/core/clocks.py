"""The monotonic clock and the system's, and how to go from one to the other."""

from __future__ import annotations

import time

READINGS = 10  # of both clocks at most, of which the quickest counts: a process may be held up between them
QUICK_S = 2e-5  # that a reading takes where the process is not held up


def now_by_both_clocks() -> tuple[float, int]:
    """Return the monotonic time in seconds and the system's in nanoseconds, read as near together as they come."""
    best = (float("inf"), 0.0, 0)  # seconds that the reading took, and both times
    for _ in range(READINGS):
        before, system_ns, after = time.monotonic(), time.time_ns(), time.monotonic()
        best = min(best, (after - before, (before + after) / 2, system_ns))
        if best[0] <= QUICK_S:
            break
    return best[1:]
