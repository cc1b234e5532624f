"""Calls to other nodes, which may be slow, restarted or dead: retries, deadlines and confirmed refusals."""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from typing import Any

from rclpy.client import Client
from rclpy.experimental import EventsExecutor
from rclpy.signals import SignalHandlerOptions, get_current_signal_handlers_options

from rkhs_ros.base.endings import Stop, deferred_signals
from rkhs_ros.nodes.core.spin import SIGNAL_CHECK_S, PeerError, ReportingNode, StoppedError

REFUSAL_STANDS_S = 2.0  # for which a node must repeat a refusal
LOGGED_AFTER_S = 3.0  # of waiting for a node
FIRST_RETRY_S, LONGEST_RETRY_S = 0.5, 2.0  # without an answer before a request is repeated; exponential back-off


def _interrupts_held() -> AbstractContextManager[None]:
    """Hold signals while the executor runs: it loses exceptions of signal handlers while it converts a message.

    If rclpy handles the signals of this process, leave them to rclpy.
    """
    is_free = get_current_signal_handlers_options() == SignalHandlerOptions.NO
    return deferred_signals() if is_free else nullcontext()


class SilentError(PeerError):
    """A node was silent for too long."""


class Peers:
    """A node's calls to other nodes; the node handles its own messages while it waits for answers.

    Owns the executor of the calling node.

    Args:
        node: the calling node.
        timeout_s: after which a silent node is an error.

    Attributes:
        stop: set when the process must exit.
        timeout_s: as above.
    """

    def __init__(self, node: ReportingNode, timeout_s: float) -> None:
        self.stop = Stop()
        self.timeout_s = timeout_s
        self._node = node
        self._executor = EventsExecutor(context=node.context)
        self._executor.add_node(node)

    def close(self) -> None:
        """Stop handling messages."""
        self._executor.shutdown()

    def spin(self, condition: Callable[[], bool], seconds: float) -> bool:
        """Handle messages until the condition holds or the time is over; return whether it holds.

        Raises:
            StoppedError: the process was asked to exit.
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
            StoppedError: the process was asked to exit.
        """
        self.spin(lambda: False, seconds)

    def wait_for_service(self, client: Client, name: str) -> None:
        """Wait until a node offers a service.

        Raises:
            PeerError: the node does not offer it in time.
        """
        begin = time.monotonic()
        if self.spin(client.service_is_ready, min(LOGGED_AFTER_S, self.timeout_s)):
            return
        if self.timeout_s > LOGGED_AFTER_S:
            self._log_waiting(name, begin)
        if not self.spin(client.service_is_ready, begin + self.timeout_s - time.monotonic()):
            raise self.silent(name)

    def _log_waiting(self, name: str, begin: float) -> None:
        left = max(begin + self.timeout_s - time.monotonic(), 0.0)
        self._node.get_logger().info(f"waiting for the {name} node, for at most {left:.0f} s")

    def call(self, client: Client, request: Any, name: str) -> Any:
        """Return a node's answer; repeat a lost request, as happens to nodes that have just discovered each other.

        Raises:
            PeerError: no answer arrived in time.
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
        """Repeat a request until the node accepts it.

        A single refusal does not count, because it may come from a second node that is about to exit.

        Raises:
            ValueError: the node keeps refusing; the message says why.
            PeerError: no answer arrived in time.
        """
        deadline = time.monotonic() + REFUSAL_STANDS_S
        while not (response := ask()).accepted:
            if time.monotonic() > deadline:
                raise ValueError(f"the {name} node refused: {response.message}")
            self.rest(SIGNAL_CHECK_S)
        return response

    def call_until_connected(self, ask: Callable[[], Any], name: str) -> Any:
        """Repeat a request until the node is connected to its peers.

        Raises:
            PeerError: the node is not connected in time.
        """
        begin, is_logged = time.monotonic(), False
        while not (response := ask()).connected:
            waited = time.monotonic() - begin
            if waited > self.timeout_s:
                raise self.silent(name, "found no peers")
            if waited > LOGGED_AFTER_S and not is_logged:
                self._log_waiting(f"peers of the {name}", begin)
                is_logged = True
            self.rest(SIGNAL_CHECK_S)  # a request may contain a whole policy
        return response

    def check_progress(self, since: float, what: str) -> bool:
        """Return True until the timeout has passed; after half of it, report this node as stuck.

        Args:
            since: monotonic time of the last progress, in seconds.
            what: obstacle to report.
        """
        self._node.diagnostics.stuck = what if self.stalled(since) else ""
        return time.monotonic() - since <= self.timeout_s

    def stalled(self, since: float) -> bool:
        """Return whether half of the timeout has passed since the last progress, a monotonic time in seconds."""
        return time.monotonic() - since > self.timeout_s / 2

    def silent(self, name: str, how: str = "did not answer") -> SilentError:
        """Return the error that a node was silent for too long."""
        return SilentError(f"the {name} node {how} within {self.timeout_s:g} s")
