"""PyBullet without its banner, which it writes directly to the file descriptors."""

import ctypes
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

__all__ = ["connected", "pybullet", "silence"]


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


try:
    with silence(1), silence(2):
        import pybullet
    from pybullet_utils.bullet_client import BulletClient
except ImportError as _error:
    raise ImportError("PyBullet is missing: pip install pybullet==3.2.7") from _error


def connected(rate: float, **parameters: Any) -> BulletClient:
    """Return a new simulator without a window, with repeatable contacts and a rate in steps per second."""
    with silence(1):
        client = BulletClient(pybullet.DIRECT)
    client.setPhysicsEngineParameter(fixedTimeStep=1.0 / rate, deterministicOverlappingPairs=1, **parameters)
    return client
