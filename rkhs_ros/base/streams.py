"""Standard streams that may be lost: messages may fail, runs not."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import Any, TextIO


class Lossy:
    """A stream whose reader may go away, or whose disk may be full; from then on it leads nowhere.

    Args:
        stream: the stream; None, as Python has it, where it is closed.
        losses: errors that are no more than a loss; others are raised.
    """

    def __init__(self, stream: TextIO | None, losses: type[OSError] = OSError) -> None:
        self._stream = stream or open(os.devnull, "w")  # noqa: SIM115  # for as long as the process lasts
        self._losses = losses

    def write(self, text: str) -> int:
        """Write, or let the text be lost."""
        with self._lost():
            self._stream.write(text)
        return len(text)

    def flush(self) -> None:
        """Flush, or let what was written be lost."""
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
        """Have what the stream still holds not fail at the end of the process."""
        nowhere = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nowhere, self._stream.fileno())
        os.close(nowhere)
        with suppress(OSError):
            self._stream.flush()


@contextmanager
def messages_may_be_lost() -> Iterator[None]:
    """Let the process go on where standard error is closed, or is lost meanwhile."""
    for descriptor in range(3):  # a file opened later would take the number of a closed stream, and its messages
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
        sys.stderr = before or sys.stderr  # without one, print would take standard output


@contextmanager
def readers_may_leave() -> Iterator[None]:
    """Let the process go on where those who read standard output have seen enough, as ``head`` does.

    Raises:
        OSError: what was printed is lost otherwise, as on a full disk.
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
