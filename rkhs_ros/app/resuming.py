"""Resume a run over topics after a node has died or fallen silent."""

import sys
import time
from collections.abc import Callable

from rkhs_ros.base.endings import FAILED, RESUMABLE

MOST_RESUMES, WINDOW_S = 5, 300.0  # of a run within the window; one more fault ends it


def resuming(run: Callable[[], int], stored: Callable[[], int]) -> int:
    """Run the nodes of a run, and resume it whenever a node has died or fallen silent.

    A run that stores no further iteration is resumed as often at most, however long that takes: it may fail at the same
    step each time.

    Args:
        run: runs the nodes until one ends, and returns the exit code; resumes the run if it has started.
        stored: returns the number of stored iterations.

    Returns:
        Exit code of the run.
    """
    resumed: list[float] = []
    code, iterations = run(), 0
    while code == RESUMABLE:
        now, before, iterations = time.monotonic(), iterations, stored()
        if iterations > before:
            resumed = [each for each in resumed if now - each < WINDOW_S]
        if len(resumed) == MOST_RESUMES:
            how = f"{MOST_RESUMES} times within {WINDOW_S:g} s or without a further iteration"
            print(f"error: the run was resumed {how}", file=sys.stderr)
            return FAILED
        resumed.append(now)
        count = f"{len(resumed)} of at most {MOST_RESUMES} times within {WINDOW_S:g} s"
        print(f"warning: the run resumes after iteration {iterations} ({count})", file=sys.stderr)
        code = run()
    return code
