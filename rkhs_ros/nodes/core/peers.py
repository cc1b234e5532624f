"""Calls to other nodes, which may be slow or dead."""

import secrets
import time
from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager, nullcontext
from typing import Any

import rclpy
from rclpy.client import Client
from rclpy.context import Context
from rclpy.exceptions import NameValidationException
from rclpy.experimental import EventsExecutor
from rclpy.signals import SignalHandlerOptions, get_current_signal_handlers_options

from rkhs_ros.base.endings import SilentError, Stop, StoppedError, deferred_signals
from rkhs_ros.base.validation import truncated
from rkhs_ros.nodes.core.diagnostics import UNCONNECTED, Diagnostics
from rkhs_ros.nodes.core.spin import SIGNAL_CHECK_S, ReportingNode
from rkhs_ros.nodes.core.transport import using_udp

LOGGED_AFTER_S = 3.0  # of waiting for a node
REPEAT_S = 1.0  # without an answer to a repeatable request
CHECK_S = 0.5  # between checks whether a call takes too long


def fresh_number() -> int:
    """Return a random identifier of a batch or a policy, unique among all clients; no result depends on it."""
    return 1 + secrets.randbelow(2**63 - 1)


def _interrupts_held() -> AbstractContextManager[None]:
    """Hold signals while the executor runs: it loses exceptions of signal handlers while it converts a message.

    If rclpy handles the signals of this process, leave them to rclpy.
    """
    is_free = get_current_signal_handlers_options() == SignalHandlerOptions.NO
    return deferred_signals() if is_free else nullcontext()


class Peers:
    """A node's calls to other nodes; the node handles its own messages while it waits for answers.

    Owns the executor of the calling node. A node that is silent for `timeout_s` seconds is an error.
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
        """Handle messages until the condition holds or the time is over; return whether it holds."""
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

    def wait_for_service(self, client: Client, name: str) -> None:
        """Wait until a node offers a service; raise SilentError if it does not in time."""
        if self.spin(client.service_is_ready, min(LOGGED_AFTER_S, self.timeout_s)):
            return
        left = self.timeout_s - LOGGED_AFTER_S
        if left > 0.0:
            self._node.get_logger().info(f"waiting for the {name} node, for at most {left:.0f} s")
        if not self.spin(client.service_is_ready, left):
            raise self.silent(name)

    def call(self, client: Client, request: Any, name: str, *, repeatable: bool = False) -> Any:
        """Return a node's answer; raise SilentError if none arrives in time.

        A repeatable request is repeated every second. An answer is lost if the node has not yet discovered the client,
        so the first request to a node must be repeatable.
        """
        begin = sent = time.monotonic()
        future = client.call_async(request)
        while not self.spin(future.done, min(CHECK_S, max(begin + self.timeout_s - time.monotonic(), 0.0))):
            now = time.monotonic()
            if now >= begin + self.timeout_s:
                client.remove_pending_request(future)
                raise self.silent(name)
            self._node.diagnostics.stuck = f"the {name} node does not answer" * (now > begin + self.timeout_s / 2)
            if repeatable and now >= sent + REPEAT_S:
                client.remove_pending_request(future)
                future, sent = client.call_async(request), now
        self._node.diagnostics.stuck = ""
        return future.result()

    def call_until_accepted(self, ask: Callable[[], Any], name: str) -> Any:
        """Repeat a request until the nodes that its node needs have discovered each other; ValueError if it refuses."""
        deadline = time.monotonic() + self.timeout_s
        while not (response := ask()).success:
            if not response.message.startswith(UNCONNECTED):
                raise ValueError(f"the {name} node refused: {response.message}")
            if time.monotonic() > deadline:
                raise SilentError(f"the {name} node is {response.message}")
            self.spin(lambda: False, SIGNAL_CHECK_S)
        return response

    def silent(self, name: str, how: str = "did not answer") -> SilentError:
        """Return the error that a node was silent for too long."""
        return SilentError(f"the {name} node {how} within {self.timeout_s:g} s")


class ClientNode(ReportingNode):
    """A node that calls others, with a ROS context of its own, so that its process may have other nodes.

    A node that is silent for ``timeout`` seconds is an error. ``report`` returns further values to report. Without a
    domain, it is that of ROS_DOMAIN_ID. Raises ValueError for an invalid namespace.
    """

    def __init__(
        self,
        name: str,
        timeout: float,
        *,
        namespace: str = "",
        domain: int | None = None,
        report: Callable[[], Mapping[str, object]] = dict,
    ) -> None:
        context = Context()
        with using_udp():
            rclpy.init(args=[], context=context, domain_id=domain, signal_handler_options=SignalHandlerOptions.NO)
            try:
                super().__init__(name, context=context, namespace=f"/{namespace.strip('/')}")
            except NameValidationException as error:
                context.try_shutdown()
                raise ValueError(f"namespace: expected a ROS namespace, got {truncated(repr(namespace))}") from error
        self.diagnostics = Diagnostics(self, report)
        self.peers = Peers(self, timeout)

    def close(self) -> None:
        """Destroy the node and its context."""
        if self.context.ok():
            self.peers.close()
            self.destroy_node()
            self.context.try_shutdown()
