"""Measure the time of calls, and how it grows."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from statistics import median


def seconds_of(call: Callable[[], object], repeats: int) -> float:
    """Return the median time of a call, after a warm-up call."""
    call()
    times = []
    for _ in range(repeats):
        begin = time.perf_counter()
        call()
        times.append(time.perf_counter() - begin)
    return median(times)


def growth(amounts: dict[int, float], first: int, last: int) -> float:
    """Return the exponent of growth from the first to the last number of samples."""
    return math.log(amounts[last] / amounts[first]) / math.log(last / first)
