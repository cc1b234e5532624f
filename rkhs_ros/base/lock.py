"""Lock a run folder for one process at a time."""

from __future__ import annotations

import fcntl
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO

from rkhs_ros.base.files import open_regular, require_replaceable

PROBES, PROBE_S = 5, 0.002  # attempts and seconds between them, because `is_locked` takes the lock for a moment


def is_locked(folder: Path) -> bool:
    """Return whether a process uses the run in a folder."""
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
    """Hold the lock of a run folder; the kernel releases it when this process ends, however it ends.

    Args:
        folder: folder of the run. The file ``checkpoints/lock`` stays in it, because a new file would be another lock.

    Raises:
        ValueError: another process holds the lock.
        OSError: the folder cannot be written.
    """
    (folder / "checkpoints").mkdir(exist_ok=True)
    path = folder / "checkpoints" / "lock"
    require_replaceable(path)
    with path.open("ab") as file:
        if not any(_is_taken(file) for _ in range(PROBES)):
            raise ValueError(f"{folder}: expected a free run folder, got one in use by another process")
        yield


def _is_taken(file: IO[bytes]) -> bool:
    """Try to take the lock and return whether that worked; wait a moment if it did not."""
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        time.sleep(PROBE_S)
        return False
    return True
