"""Write files atomically, and lock a run folder for one process at a time."""

import fcntl
import os
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import IO


def write_whole(path: Path, content: bytes, *, sync: bool = True) -> None:
    """Write a file atomically; if that fails, the old file stays and no temporary file is left.

    With ``sync``, wait until the content and the folder's entry are on disk; otherwise a power cut may lose or damage
    them.
    """
    aside = path.with_name(path.name + ".part")
    try:
        with named(path):
            aside.write_bytes(content)
            if sync:
                sync_to_disk(aside)
            aside.replace(path)
    except BaseException:
        with suppress(OSError):
            aside.unlink()
        raise
    if sync:
        sync_to_disk(path.parent)


def sync_to_disk(path: Path) -> None:
    """Wait until the content of a file, or the entries of a folder, are on disk."""
    with named(path):
        descriptor = os.open(path, os.O_RDONLY)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)


@contextmanager
def named(path: Path) -> Iterator[None]:
    """Add the file's name to an OSError, because errors of writing lack it."""
    try:
        yield
    except OSError as error:
        raise OSError(error.errno, error.strerror, str(path)) from error


DOMAIN_FILE = "domain"  # in the folder of a run over topics, whose launcher holds a lock on it
ATTEMPTS, PAUSE_S = 10, 0.002  # to take a lock, which `is_locked` of other processes shares for a moment


def is_locked(folder: Path, name: str = "lock") -> bool:
    """Return whether a process holds the lock of a file in a run folder."""
    try:
        with (folder / name).open("rb") as file:
            fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except BlockingIOError:
        return True
    except OSError:
        return False
    return False


@contextmanager
def locked(folder: Path, name: str = "lock") -> Iterator[None]:
    """Hold the lock of a file in a run folder; the kernel releases it when this process ends, however it ends.

    The file ``lock`` stays in the folder, because a new file would be another lock.
    """
    with (folder / name).open("ab") as file:
        if not any(_is_taken(file) for _ in range(ATTEMPTS)):
            raise ValueError(f"{folder}: expected a free run folder, got one in use by another process")
        yield


def _is_taken(file: IO[bytes]) -> bool:
    """Try to take a lock, and return whether that succeeded; if not, wait for a moment."""
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        time.sleep(PAUSE_S)
        return False
    return True
