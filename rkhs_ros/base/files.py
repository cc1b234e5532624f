"""Read files of bounded size and write files atomically."""

from __future__ import annotations

import os
import stat
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import BinaryIO

# Largest file that is read into memory: a quarter of the machine's memory, because its unpacked content needs some too.
MOST_BYTES = os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE") // 4
# Bytes that any file may be unpacked to, and the allowed ratio of unpacked to packed bytes beyond them.
SMALL, MOST_EXPANSION = 2**26, 20


def open_regular(path: Path) -> BinaryIO:
    """Open a regular file for reading.

    Pipes and devices are rejected, because reading them may block or never end.

    Raises:
        ValueError: the path is not a regular file.
        OSError: the file cannot be opened.
    """
    return open(path, "rb", opener=_regular)


def read_whole(path: Path, most: int = MOST_BYTES) -> bytes:
    """Return the content of a regular file.

    Args:
        path: the file.
        most: maximum size in bytes.

    Raises:
        ValueError: the file is larger, or not a regular file.
        OSError: the file cannot be read.
    """
    with open_regular(path) as file:
        size = os.fstat(file.fileno()).st_size
        if size > most:
            raise ValueError(f"{path}: expected a file of at most {most} bytes, got {size}")
        return file.read(size)


def require_expansion(size: int, packed: int, what: str) -> None:
    """Check the size of content before it is unpacked.

    Args:
        size: unpacked size in bytes.
        packed: packed size in bytes.
        what: name of the content, used in the message.

    Raises:
        ValueError: the unpacked content is too large for its packed size.
    """
    most = SMALL + MOST_EXPANSION * packed
    if size > most:
        raise ValueError(f"{what}: expected at most {most} bytes unpacked from {packed}, got {size}")


def _regular(path: str, flags: int) -> int:
    """Open a regular file and return its descriptor; folders also pass, because `open` rejects them itself."""
    descriptor = os.open(path, flags | os.O_NONBLOCK)  # without it, opening a pipe waits for a writer
    mode = os.fstat(descriptor).st_mode
    if stat.S_ISREG(mode) or stat.S_ISDIR(mode):
        return descriptor
    os.close(descriptor)
    raise ValueError(f"{path}: expected a regular file, got a pipe, a device or a socket")


def write_whole(path: Path, content: bytes, *, sync: bool = True) -> None:
    """Write a file atomically; if that fails, the old file stays and no temporary file is left.

    Args:
        path: the file.
        content: its new content.
        sync: wait until the content and the folder's entry are on disk; otherwise a power cut may lose or damage them.

    Raises:
        OSError: the file cannot be written; the message names it.
        ValueError: the path exists but is not a file.
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
    """Check that a file may replace this path; replacing a device would remove it for all its users.

    Raises:
        ValueError: the path is a device. The operating system itself rejects folders.
    """
    if path.exists() and not (path.is_file() or path.is_dir()):
        raise ValueError(f"{path}: expected a file or a free path, got a device")


def sync_to_disk(path: Path) -> None:
    """Wait until the content of a file, or the entries of a folder, are on disk.

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
    """Add the file's name to an OSError, because errors of writing lack it.

    Raises:
        OSError: the same error with the file's name.
    """
    try:
        yield
    except OSError as error:
        raise OSError(error.errno, error.strerror, str(path)) from error
