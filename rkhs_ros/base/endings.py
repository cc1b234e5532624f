"""How a process ends: exit codes, signals and errors in one line; and how it outlives its standard streams."""

import errno
import os
import signal
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import Any, TextIO

FAILED = 1  # a node, an environment, a disk or one of several runs failed
BAD_INPUT = 2
RESUMABLE = os.EX_TEMPFAIL  # a node died or was silent for too long; the run can be resumed
INTERRUPTED = 130  # by Ctrl-C or SIGTERM; the shells' convention
ENDING = (signal.SIGINT, signal.SIGTERM)
DISK_ERRORS = {errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO}


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
        """Request the stop.

        Raises:
            StoppedError: the first request comes in a block of `interrupting`.
        """
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


def exit_code(error: Exception) -> int:
    """Return the exit code for an error that ends the process."""
    failed = isinstance(error, RunError) or (isinstance(error, OSError) and error.errno in DISK_ERRORS)
    return FAILED if failed else BAD_INPUT


def print_error(error: Exception) -> int:
    """Print an error as one line on stderr and return its exit code."""
    print("error:", error_message(error), file=sys.stderr, flush=True)
    return exit_code(error)


def error_message(error: Exception) -> str:
    """Return the message of an error as one line."""
    text = str(error)
    if isinstance(error, FileNotFoundError) and error.filename is not None:
        text = f"{error.filename}: expected an existing file or folder, got none"
    return " ".join(text.splitlines())


class Lossy:
    """Text stream that discards output once its reader is gone or the disk is full.

    Args:
        stream: stream to write to; None, Python's value for a closed stream, discards all output.
        losses: errors to ignore; other errors are raised.
    """

    def __init__(self, stream: TextIO | None, losses: type[OSError] = OSError) -> None:
        self._stream = stream or open(os.devnull, "w")  # noqa: SIM115  # for as long as the process lasts
        self._losses = losses

    def write(self, text: str) -> int:
        """Write text, or discard it if the stream is lost."""
        with self._lost():
            self._stream.write(text)
        return len(text)

    def flush(self) -> None:
        """Flush the stream, or discard its buffer if the stream is lost."""
        with self._lost():
            self._stream.flush()

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)

    @contextmanager
    def _lost(self) -> Iterator[None]:
        try:
            yield
        except OSError as error:
            self._lead_nowhere()
            if not isinstance(error, self._losses):
                raise OSError(error.errno, error.strerror, self._stream.name) from error

    def _lead_nowhere(self) -> None:
        """Redirect the stream to the null device, so that its buffer causes no error when the process exits."""
        nowhere = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nowhere, self._stream.fileno())
        os.close(nowhere)
        with suppress(OSError):
            self._stream.flush()


@contextmanager
def tolerate_lost_stderr() -> Iterator[None]:
    """Ignore errors of standard error, whether it is closed now or lost later."""
    for descriptor in range(3):  # a file opened later would get the number of a closed stream and receive its messages
        try:
            os.fstat(descriptor)
        except OSError:
            os.open(os.devnull, os.O_RDWR)
    before = sys.stderr
    sys.stderr = Lossy(before)
    try:
        yield
    finally:
        sys.stderr.flush()
        sys.stderr = before or sys.stderr  # without it, print would write to standard output


@contextmanager
def tolerate_closed_stdout() -> Iterator[None]:
    """Ignore a closed pipe on standard output, such as a pipe to ``head`` after it exits.

    Raises:
        OSError: the output is lost for another reason, for example a full disk.
    """
    before = sys.stdout
    sys.stdout = Lossy(before, BrokenPipeError)
    try:
        yield
    finally:
        try:
            sys.stdout.flush()
        finally:
            sys.stdout = before
