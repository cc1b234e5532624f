"""Files that are read within bounds, and written whole or not at all."""

from __future__ import annotations

import os
import stat
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import BinaryIO

# Bytes of a file that is read into memory: a quarter of the machine's, since what is unpacked from it needs some, too.
MOST_BYTES = os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE") // 4
SMALL, MOST_EXPANSION = 2**26, 20  # bytes that anything may be unpacked to, and how many times its size beyond


def open_regular(path: Path) -> BinaryIO:
    """Open a regular file for reading: reading a pipe or a device may block, or never end.

    Raises:
        ValueError: it is something else.
        OSError: it cannot be opened.
    """
    return open(path, "rb", opener=_regular)


def read_whole(path: Path, most: int = MOST_BYTES) -> bytes:
    """Return the content of a regular file.

    Args:
        path: the file.
        most: bytes that it may have.

    Raises:
        ValueError: it is larger, or no regular file.
        OSError: it cannot be read.
    """
    with open_regular(path) as file:
        size = os.fstat(file.fileno()).st_size
        if size > most:
            raise ValueError(f"{path}: expected a file of at most {most} bytes, got {size}")
        return file.read(size)


def require_expansion(size: int, packed: int, what: str) -> None:
    """Check what something would be unpacked to.

    Args:
        size: in bytes.
        packed: its size before.
        what: it is.

    Raises:
        ValueError: it would grow beyond all measure.
    """
    most = SMALL + MOST_EXPANSION * packed
    if size > most:
        raise ValueError(f"{what}: expected at most {most} bytes in {packed}, got {size}")


def _regular(path: str, flags: int) -> int:
    """Return the descriptor of a file, or of a folder, which Python refuses by itself."""
    descriptor = os.open(path, flags | os.O_NONBLOCK)  # else opening a pipe waits for a writer
    mode = os.fstat(descriptor).st_mode
    if stat.S_ISREG(mode) or stat.S_ISDIR(mode):
        return descriptor
    os.close(descriptor)
    raise ValueError(f"{path}: expected a regular file, got a pipe, a device or a socket")


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
