"""Lock a run folder for one process at a time."""

import fcntl
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO

PROBE_S = 0.002  # seconds between attempts while `is_locked` of other processes shares the lock for a moment


def is_locked(folder: Path) -> bool:
    """Return whether a process uses the run in a folder."""
    try:
        with (folder / "lock").open("rb") as file:
            fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except BlockingIOError:
        return True
    except OSError:
        return False
    return False


@contextmanager
def locked(folder: Path) -> Iterator[None]:
    """Hold the lock of a run folder; the kernel releases it when this process ends, however it ends.

    Args:
        folder: folder of the run. The file ``lock`` stays in it, because a new file would be another lock.

    Raises:
        ValueError: another process holds the lock.
        OSError: the folder cannot be written.
    """
    with (folder / "lock").open("ab") as file:
        if not _take(file):
            raise ValueError(f"{folder}: expected a free run folder, got one in use by another process")
        yield


def _take(file: IO[bytes]) -> bool:
    """Take the lock and return True; return False if a run holds it.

    A run holds the lock exclusively, `is_locked` only shares it. If the lock can be shared, no run holds it, and the
    next attempt may succeed.
    """
    while not _lock(file, fcntl.LOCK_EX):
        if not _lock(file, fcntl.LOCK_SH):
            return False
        fcntl.flock(file, fcntl.LOCK_UN)
        time.sleep(PROBE_S)
    return True


def _lock(file: IO[bytes], kind: int) -> bool:
    try:
        fcntl.flock(file, kind | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    return True
