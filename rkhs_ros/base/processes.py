"""Processes that do not outlive the one that started them."""

from __future__ import annotations

import ctypes
import signal

PR_SET_PDEATHSIG = 1  # of prctl(2)
_libc = ctypes.CDLL(None)


def terminate_with_parent() -> None:
    """Have the kernel end this process when the one that started it dies, however it does."""
    _libc.prctl(PR_SET_PDEATHSIG, signal.SIGTERM)
