"""Suppression of PyBullet's banner, which it writes directly to the file descriptors."""

from __future__ import annotations

import ctypes
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def silence(descriptor: int) -> Iterator[None]:
    """Discard all output to a file descriptor: 1 is standard output, 2 is standard error."""
    _flush()
    original = os.dup(descriptor)
    nothing = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nothing, descriptor)
    try:
        yield
    finally:
        _flush()  # otherwise C's buffer would be written later
        os.dup2(original, descriptor)
        os.close(original)
        os.close(nothing)


def _flush() -> None:
    sys.stdout.flush()
    sys.stderr.flush()
    ctypes.CDLL(None).fflush(None)
