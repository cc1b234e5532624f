"""A run for one process at a time."""

from __future__ import annotations

import fcntl
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


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
    with (folder / "checkpoints" / "lock").open("ab") as file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            raise ValueError(f"{folder}: expected a folder of its own, got one in use by another process") from error
        yield
