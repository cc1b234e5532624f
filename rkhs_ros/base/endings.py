"""How a process ends: exit codes, signals and errors in one line."""

import errno
import os
import signal
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress

FAILED = 1  # a node, an environment, a disk or one of several runs failed
BAD_INPUT = 2
RESUMABLE = os.EX_TEMPFAIL  # a node died or was silent for too long; the run can be resumed
INTERRUPTED = 130  # by Ctrl-C or SIGTERM; the shells' convention
ENDING = (signal.SIGINT, signal.SIGTERM)
DISK_ERRORS = {errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO, errno.EROFS}


class RunError(RuntimeError):
    """A failure of a run whose settings are valid; the message names in one line what failed and where."""


class SilentError(RunError):
    """A node was silent for too long; the message names it."""


class StoppedError(BaseException):
    """The process was asked to exit. It is no error, so ``except Exception`` does not catch it."""


class Stop:
    """A flag that a signal handler sets to stop the process.

    A second signal may interrupt the handler, so that Python calls it again inside itself. ``threading.Event`` would
    then deadlock, because the first call may hold its lock.
    """

    def __init__(self) -> None:
        self._is_set = False
        self._interrupts = False

    def set(self) -> None:
        """Request the stop."""
        first, self._is_set = not self._is_set, True
        if first and self._interrupts:
            raise StoppedError

    def is_set(self) -> bool:
        """Return whether a stop was requested."""
        return self._is_set

    @contextmanager
    def interrupting(self, interrupts: bool = True) -> Iterator[None]:
        """Let a request interrupt the block at once; or hold requests, within such a block, until this block exits.

        Raises:
            StoppedError: the stop is requested.
        """
        before, self._interrupts = self._interrupts, interrupts
        try:
            yield
        finally:
            self._interrupts = before
        if before and self._is_set:
            raise StoppedError


@contextmanager
def deferred_signals() -> Iterator[None]:
    """Defer SIGINT and SIGTERM until the block exits; a no-op outside the main thread, which handles all signals."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    held: list[int] = []
    handlers = {number: signal.getsignal(number) for number in ENDING}  # read all before the first change
    try:
        for number in ENDING:
            signal.signal(number, lambda number, frame: held.append(number))
        yield
    finally:
        for number, handler in handlers.items():
            signal.signal(number, handler)
        if held:
            signal.raise_signal(held[0])


def print_error(error: Exception) -> int:
    """Print an error that ends the process as one line on stderr, and return its exit code."""
    with suppress(BlockingIOError):  # of output that nobody reads
        print("error:", error_message(error), file=sys.stderr, flush=True)
    failed = isinstance(error, RunError) or (isinstance(error, OSError) and error.errno in DISK_ERRORS)
    return FAILED if failed else BAD_INPUT


def error_message(error: Exception) -> str:
    """Return the message of an error as one line."""
    text = str(error)
    if isinstance(error, FileNotFoundError) and error.filename is not None:
        text = f"{error.filename}: expected an existing file or folder, got none"
    elif isinstance(error, OSError) and error.filename is not None and error.strerror:
        text = f"{error.filename}: {error.strerror.lower()}"
    return " ".join(text.splitlines())
