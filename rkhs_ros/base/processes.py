"""Processes that end with their parent, and computations that use one thread."""

import ctypes
import os
import signal
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache

from threadpoolctl import ThreadpoolController

PR_SET_PDEATHSIG = 1  # of prctl(2)
_libc = ctypes.CDLL(None)


def terminate_with_parent(parent: int) -> None:
    """Make the kernel terminate this process when its parent dies, however it dies.

    Args:
        parent: process id of the parent.
    """
    _libc.prctl(PR_SET_PDEATHSIG, signal.SIGTERM)
    if os.getppid() != parent:  # the parent is already dead
        os.kill(os.getpid(), signal.SIGTERM)


@contextmanager
def one_thread() -> Iterator[None]:
    """Limit linear algebra to one thread within the context, overriding the environment."""
    with _loaded().limit(limits=1):
        yield


@cache
def _loaded() -> ThreadpoolController:
    """Return the loaded linear-algebra libraries; cached, because the search covers the whole process."""
    import scipy.linalg  # noqa: F401  # numpy and scipy load all the linear algebra in use

    return ThreadpoolController().select(user_api="blas")
