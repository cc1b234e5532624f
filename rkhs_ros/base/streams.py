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
    """

    def __init__(self, stream: TextIO | None) -> None:
        self._stream = stream or open(os.devnull, "w")  # noqa: SIM115  # for as long as the process lasts

    def write(self, text: str) -> int:
        """Write, or let the text be lost."""
        try:
            return self._stream.write(text)
        except OSError:
            self._lose()
            return len(text)

    def flush(self) -> None:
        """Flush, or let what was written be lost."""
        try:
            self._stream.flush()
        except OSError:
            self._lose()

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)

    def _lose(self) -> None:
        """Have the stream lead nowhere, that what it still holds does not fail at the end of the process."""
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
