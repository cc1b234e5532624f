"""Files written whole or not at all."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path


def write_whole(path: Path, content: bytes, *, sync: bool = True) -> None:
    """Put a file in place of another, or of none; where that fails the old one stays and nothing is left beside it.

    Args:
        path: the file.
        content: what it shall hold.
        sync: wait until the disk has it, and the folder its name; else a power cut may lose it, or leave it damaged.

    Raises:
        OSError: it cannot be written; the message names the file.
        ValueError: there is something else than a file in its place.
    """
    require_replaceable(path)
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


def require_replaceable(path: Path) -> None:
    """Check that a file may take this place: that of a device would be gone for all who use it.

    Raises:
        ValueError: there is a device. A folder is the system's to refuse.
    """
    if path.exists() and not (path.is_file() or path.is_dir()):
        raise ValueError(f"{path}: expected a file, or nothing in its place, got a device")


def sync_to_disk(path: Path) -> None:
    """Wait until the disk has what was written to a file, or the names in a folder.

    Raises:
        OSError: the disk failed; the message names the file.
    """
    with named(path):
        descriptor = os.open(path, os.O_RDONLY)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)


@contextmanager
def named(path: Path) -> Iterator[None]:
    """Let an OSError name the file, which those of writing do not.

    Raises:
        OSError: of the same kind.
    """
    try:
        yield
    except OSError as error:
        raise OSError(error.errno, error.strerror, str(path)) from error
