"""Processes: where they search for modules, and that they end with their parent process."""

import ctypes
import os
import signal
import sys
from runpy import run_module

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


def search_here() -> None:
    """Search for modules in the working directory, after all other places."""
    if not searches_here():
        sys.path.append(os.getcwd())


def searches_here() -> bool:
    """Return whether this process searches for modules in the working directory."""
    return os.getcwd() in sys.path


def python(module: str) -> list[str]:
    """Return the command that runs a module in another process, which searches for modules where this one does."""
    return [sys.executable, "-P", "-m", *([__name__] if searches_here() else []), module]


if __name__ == "__main__":
    search_here()
    run_module(sys.argv.pop(1), run_name="__main__", alter_sys=True)
