"""PyBullet writes greetings past Python, which have no place among a program's results."""

from __future__ import annotations

import ctypes
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def silence(descriptor: int) -> Iterator[None]:
    """Let nothing through to a file descriptor: 1 is the standard output, 2 the standard error."""
    _flush()
    kept = os.dup(descriptor)
    nothing = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nothing, descriptor)
    try:
        yield
    finally:
        _flush()  # what is still in C's buffer would get through later
        os.dup2(kept, descriptor)
        os.close(kept)
        os.close(nothing)


def _flush() -> None:
    sys.stdout.flush()
    sys.stderr.flush()
    ctypes.CDLL(None).fflush(None)
