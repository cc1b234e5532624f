"""Receive the reports of a run's nodes from a child process, so that the page itself does not depend on ROS."""

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
    """The state of a node: its name, its level ("ok", "warning", "error" or "silent"), and a message."""

    name: str
    level: str
    message: str


class Report(NamedTuple):
    """The latest report of all nodes.

    Attributes:
        nodes: reports of the individual nodes.
        gate: fields of the gate's state by name; None without a gate.
        answer: result of the user's last request.
    """

    nodes: tuple[NodeReport, ...] = ()
    gate: dict[str, Any] | None = None
    answer: str = ""


class Monitor:
    """Receives reports from the nodes of a run while a browser shows the page.

    Owns the listening process and its latest report.

    Args:
        start: starts the process with pipes as standard input and output; returns None if there are no nodes.
    """

    def __init__(self, start: Start) -> None:
        self._start = start
        self._process: subprocess.Popen[bytes] | None = None
        self._retry_at = 0.0
        self._reset()

    def listen(self) -> Report:
        """Return the latest report; start the listening process if it is not running."""
        if self._process is not None and self._process.poll() is not None:
            self.stop_listening()
        if self._process is None and time.monotonic() >= self._retry_at:
            self._process, self._retry_at = self._start(), time.monotonic() + RETRY_S
            if self._process is not None and self._process.stdout is not None:
                os.set_blocking(self._process.stdout.fileno(), False)
        self._read()
        return self._report

    def stop_listening(self) -> None:
        """Stop the listening process and discard its report."""
        process, self._process = self._process, None
        self._reset()
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

    def send(self, command: str) -> None:
        """Send a user's command to the nodes, if the process is running."""
        if self._process is not None and self._process.stdin is not None:
            with suppress(OSError):
                os.write(self._process.stdin.fileno(), f"{command}\n".encode())

    def _reset(self) -> None:
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
            latest = json.loads(lines[-1])
            nodes = tuple(NodeReport(*each) for each in latest["nodes"])
            self._report = Report(nodes, latest["gate"], latest["answer"])
