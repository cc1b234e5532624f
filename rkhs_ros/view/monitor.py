"""What the nodes of a run report meanwhile, as a process beside the page hears it, so that the page knows no ROS."""

from __future__ import annotations

import json
import os
import subprocess
import time
from collections.abc import Callable
from contextlib import suppress
from typing import Any, NamedTuple

READ_BYTES = 1 << 16
RETRY_S = 3.0  # between attempts to start the process
END_TIMEOUT_S = 2.0
Start = Callable[[], "subprocess.Popen[bytes] | None"]


class NodeReport(NamedTuple):
    """What a node says of itself: its name, "ok", "warning", "error" or "silent", and why."""

    name: str
    level: str
    message: str


class Report(NamedTuple):
    """What was heard last.

    Attributes:
        nodes: that report.
        gate: fields of its state by name; None where there is no gate.
        answer: what came of what a person asked for last.
    """

    nodes: tuple[NodeReport, ...] = ()
    gate: dict[str, Any] | None = None
    answer: str = ""


class Monitor:
    """Hears the nodes of a run while somebody looks.

    Owns the process that listens, and what it told last.

    Args:
        start: starts the process, with pipes as its standard input and output; returns None where nothing can be heard.
    """

    def __init__(self, start: Start) -> None:
        self._start = start
        self._process: subprocess.Popen[bytes] | None = None
        self._retry_at = 0.0
        self._forget()

    def listen(self) -> Report:
        """Return what was heard last; begin to listen if nobody does."""
        if self._process is not None and self._process.poll() is not None:
            self.rest()
        if self._process is None and time.monotonic() >= self._retry_at:
            self._process, self._retry_at = self._start(), time.monotonic() + RETRY_S
            if self._process is not None and self._process.stdout is not None:
                os.set_blocking(self._process.stdout.fileno(), False)
        self._read()
        return self._report

    def rest(self) -> None:
        """Listen no more, and forget what was heard."""
        process, self._process = self._process, None
        self._forget()
        if process is None:
            return
        for pipe in (process.stdin, process.stdout):
            if pipe is not None:
                with suppress(OSError):
                    pipe.close()
        process.terminate()
        try:
            process.wait(END_TIMEOUT_S)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()

    def say(self, word: str) -> None:
        """Pass on what a person decided, if somebody listens."""
        if self._process is not None and self._process.stdin is not None:
            with suppress(OSError):
                os.write(self._process.stdin.fileno(), f"{word}\n".encode())

    def _forget(self) -> None:
        self._report = Report()
        self._rest = b""

    def _read(self) -> None:
        if self._process is None or self._process.stdout is None:
            return
        with suppress(BlockingIOError):
            while content := os.read(self._process.stdout.fileno(), READ_BYTES):
                self._rest += content
        *lines, self._rest = self._rest.split(b"\n")
        if lines:
            told = json.loads(lines[-1])
            self._report = Report(tuple(NodeReport(*each) for each in told["nodes"]), told["gate"], told["answer"])
