"""Keep a run alive when its standard streams are closed or full."""

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import Any, TextIO


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
