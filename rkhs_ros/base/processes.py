"""Processes that do not outlive the one that started them."""

from __future__ import annotations

import ctypes
import os
import signal

PR_SET_PDEATHSIG = 1  # of prctl(2)
_libc = ctypes.CDLL(None)


def terminate_with_parent(parent: int) -> None:
    """Have the kernel end this process when the one that started it dies, however it does.

    Args:
        parent: number of the process that started this one.
    """
    _libc.prctl(PR_SET_PDEATHSIG, signal.SIGTERM)
    if os.getppid() != parent:  # it died already
        os.kill(os.getpid(), signal.SIGTERM)
