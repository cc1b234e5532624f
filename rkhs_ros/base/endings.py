"""How a process ends: its exit codes, and the errors that end it with one line."""

from __future__ import annotations

import errno
import signal
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager

FAILED = 1  # a node, an environment, a disk, or a run of several
BAD_INPUT = 2
INTERRUPTED = 130  # by Ctrl-C or SIGTERM, as shells have it
ENDING = (signal.SIGINT, signal.SIGTERM)
DISK_ERRORS = {errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO}


class RunError(RuntimeError):
    """What ends a run whose settings are good; the message says in one line what failed, and where."""


class Stop:
    """Whether a process was told to end.

    A signal's handler tells it. A second signal may come while it does, and Python would then call the handler within
    itself: with ``threading.Event``, whose lock the first call may hold, the process would hang.
    """

    def __init__(self) -> None:
        self._is_set = False

    def set(self) -> None:
        """Tell the process to end."""
        self._is_set = True

    def is_set(self) -> bool:
        """Return whether it was told to."""
        return self._is_set


@contextmanager
def signals_held() -> Iterator[None]:
    """Handle signals that arrive in this block when it is left; only the main thread handles any."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    held: list[int] = []
    handlers = {number: signal.getsignal(number) for number in ENDING}  # all of them, also if a signal comes meanwhile
    try:
        for number in ENDING:
            signal.signal(number, lambda number, frame: held.append(number))
        yield
    finally:
        for number, handler in handlers.items():
            signal.signal(number, handler)
        if held:
            signal.raise_signal(held[0])


def exit_code(error: Exception) -> int:
    """Return the exit code of an error that ends a process."""
    failed = isinstance(error, RunError) or (isinstance(error, OSError) and error.errno in DISK_ERRORS)
    return FAILED if failed else BAD_INPUT


def print_error(error: Exception) -> int:
    """Say in one line on stderr what went wrong; return the exit code."""
    print("error:", error_message(error), file=sys.stderr, flush=True)
    return exit_code(error)


def error_message(error: Exception) -> str:
    """Return in one line what an error says."""
    text = str(error)
    if isinstance(error, FileNotFoundError) and error.filename is not None:
        text = f"{error.filename}: expected a file or folder that exists, got none"
    return " ".join(text.splitlines())
