"""A run for one process at a time."""

from __future__ import annotations

import fcntl
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO

from rkhs_ros.base.files import open_regular, require_replaceable

PROBES, PROBE_S = 5, 0.002  # how often, and after how long, a lock is tried again that may be a look of `is_locked`


def is_locked(folder: Path) -> bool:
    """Return whether a process is in the run of a folder."""
    try:
        with open_regular(folder / "checkpoints" / "lock") as file:
            fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except BlockingIOError:
        return True
    except (OSError, ValueError):
        return False
    return False


@contextmanager
def locked(folder: Path) -> Iterator[None]:
    """Keep other processes out of a run; the kernel lets them in once this one has ended, however it did.

    Args:
        folder: the run's; the file ``checkpoints/lock`` stays in it, for a new one would be another lock.

    Raises:
        ValueError: another process is in it.
        OSError: the folder cannot be written.
    """
    (folder / "checkpoints").mkdir(exist_ok=True)
    path = folder / "checkpoints" / "lock"
    require_replaceable(path)
    with path.open("ab") as file:
        if not any(_is_taken(file) for _ in range(PROBES)):
            raise ValueError(f"{folder}: expected a folder of its own, got one in use by another process")
        yield


def _is_taken(file: IO[bytes]) -> bool:
    """Take the lock and return whether it was free; wait a moment where it was not."""
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        time.sleep(PROBE_S)
        return False
    return True
