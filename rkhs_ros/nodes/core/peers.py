"""Calls to other nodes, which may be slow, restarted or gone: retries, deadlines, and refusals that must stand."""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from typing import Any

from rclpy.client import Client
from rclpy.experimental import EventsExecutor
from rclpy.signals import SignalHandlerOptions, get_current_signal_handlers_options

from rkhs_ros.base.endings import Stop, signals_held
from rkhs_ros.nodes.core.spin import SIGNAL_CHECK_S, PeerError, ReportingNode, StoppedError

REFUSAL_STANDS_S = 2.0  # that a node must keep to its refusal
SAID_AFTER_S = 3.0  # that a node is waited for
FIRST_RETRY_S, LONGEST_RETRY_S = 0.5, 2.0  # without an answer before a request is sent again; back-off by two


def _interrupts_held() -> AbstractContextManager[None]:
    """Hold signals while the executor runs: it loses what their handlers raise while it converts a message.

    In a process whose signals rclpy handles they are left to rclpy.
    """
    is_free = get_current_signal_handlers_options() == SignalHandlerOptions.NO
    return signals_held() if is_free else nullcontext()


class SilentError(PeerError):
    """A node was silent for too long."""


class Peers:
    """A node's calls to other nodes; its own messages are handled while it waits for their answers.

    Owns the executor of the calling node.

    Args:
        node: the calling node.
        timeout_s: after which a silent node is given up.

    Attributes:
        stop: set when the process is to end.
        timeout_s: as above.
    """

    def __init__(self, node: ReportingNode, timeout_s: float) -> None:
        self.stop = Stop()
        self.timeout_s = timeout_s
        self._node = node
        self._executor = EventsExecutor(context=node.context)
        self._executor.add_node(node)

    def close(self) -> None:
        """Handle no more messages."""
        self._executor.shutdown()

    def spin(self, condition: Callable[[], bool], seconds: float) -> bool:
        """Handle messages until the condition holds or the time is over; return whether it holds.

        Raises:
            StoppedError: the process was told to end.
        """
        deadline = time.monotonic() + seconds
        while not condition():
            left = deadline - time.monotonic()
            if left <= 0:
                return False
            wait = min(left, SIGNAL_CHECK_S, self._node.heartbeat())  # new peers do not wake the executor either
            with _interrupts_held():
                self._executor.spin_once(timeout_sec=wait)
            if self.stop.is_set():
                raise StoppedError
        return True

    def rest(self, seconds: float) -> None:
        """Handle messages for some time.

        Raises:
            StoppedError: the process was told to end.
        """
        self.spin(lambda: False, seconds)

    def wait_for_service(self, client: Client, name: str) -> None:
        """Wait until a node offers a service.

        Raises:
            PeerError: it does not in time.
        """
        begin = time.monotonic()
        if self.spin(client.service_is_ready, min(SAID_AFTER_S, self.timeout_s)):
            return
        if self.timeout_s > SAID_AFTER_S:
            self._say_waiting(name, begin)
        if not self.spin(client.service_is_ready, begin + self.timeout_s - time.monotonic()):
            raise self.silent(name)

    def _say_waiting(self, name: str, begin: float) -> None:
        left = max(begin + self.timeout_s - time.monotonic(), 0.0)
        self._node.get_logger().info(f"waits for the {name} node, for {left:.0f} s more at most")

    def call(self, client: Client, request: Any, name: str) -> Any:
        """Return a node's answer; ask again where it was lost, as happens to peers that have just met.

        Raises:
            PeerError: no answer came in time.
        """
        begin, patience = time.monotonic(), FIRST_RETRY_S
        while self.check_progress(begin, f"the {name} node does not answer"):
            future = client.call_async(request)
            if self.spin(future.done, min(patience, begin + self.timeout_s - time.monotonic())):
                return future.result()
            client.remove_pending_request(future)
            patience = min(2 * patience, LONGEST_RETRY_S)
        raise self.silent(name)

    def call_until_accepted(self, ask: Callable[[], Any], name: str) -> Any:
        """Ask a node again and again until it accepts.

        A refusal must stand: one may come from a second node that is about to end.

        Raises:
            ValueError: it refuses; the message says why.
            PeerError: no answer came in time.
        """
        deadline = time.monotonic() + REFUSAL_STANDS_S
        while not (response := ask()).accepted:
            if time.monotonic() > deadline:
                raise ValueError(f"the {name} node refused: {response.message}")
            self.rest(SIGNAL_CHECK_S)
        return response

    def call_until_connected(self, ask: Callable[[], Any], name: str) -> Any:
        """Ask a node again and again until it is connected to its peers.

        Raises:
            PeerError: it is not in time.
        """
        begin, said = time.monotonic(), False
        while not (response := ask()).connected:
            waited = time.monotonic() - begin
            if waited > self.timeout_s:
                raise self.silent(name, "found no peers")
            if waited > SAID_AFTER_S and not said:
                self._say_waiting(f"peers of the {name}", begin)
                said = True
        return response

    def check_progress(self, since: float, what: str) -> bool:
        """Return whether there is time left to wait; report the node as stuck where it is stalled.

        Args:
            since: monotonic time of the last progress, in seconds.
            what: holds the node up.
        """
        self._node.diagnostics.stuck = what if self.stalled(since) else ""
        return time.monotonic() - since <= self.timeout_s

    def stalled(self, since: float) -> bool:
        """Return whether half of the timeout passed since the last progress, a monotonic time in seconds."""
        return time.monotonic() - since > self.timeout_s / 2

    def silent(self, name: str, how: str = "did not answer") -> SilentError:
        """Return the error that a node was silent for too long."""
        return SilentError(f"the {name} node {how} within {self.timeout_s:g} s")
