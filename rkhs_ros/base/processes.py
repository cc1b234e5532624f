"""Processes that end with their parent process."""

import ctypes
import os
import signal

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
