"""Service calls for an operator's commands: none is lost during discovery, and none acts twice."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Iterable
from math import inf
from typing import Any

from rcl_interfaces.srv import ListParameters
from rclpy.client import Client
from rclpy.node import Node
from rclpy.task import Future
from std_srvs.srv import SetBool, Trigger

FOUND_TIMEOUT_S, ANSWER_TIMEOUT_S = 5.0, 10.0  # until the node is found, and from then until it answers
RETRY_S = 0.5  # without an answer, before a repeatable request is sent again
SERVICES: dict[str, tuple[str, Any, Any]] = {  # by command: the service, its type, and the request
    "arm": ("gate/arm", Trigger, Trigger.Request()),
    "stop": ("gate/stop", Trigger, Trigger.Request()),
    "start": ("robot/start", Trigger, Trigger.Request()),
    "pause": ("robot/pause", SetBool, SetBool.Request(data=True)),
    "veto": ("robot/veto", Trigger, Trigger.Request()),
}
REPEATED = ("stop", "pause")  # idempotent, and both make the robot safer


class Request:
    """A request to one service, sent when the service is available, and repeated until it is answered.

    Owns the futures of the answers.

    Args:
        client: of the service.
        content: of the request.
        retry_s: seconds without an answer before the request is sent again.
    """

    def __init__(self, client: Client, content: Any, retry_s: float) -> None:
        self._client = client
        self._content = content
        self._retry_s = retry_s
        self._retry_at = -inf
        self._futures: list[Future] = []

    @property
    def is_sent(self) -> bool:
        """Whether the request was sent."""
        return bool(self._futures)

    def answer(self, now: float) -> Any:
        """Send the request if it is due; return the answer, None if there is none yet."""
        if now >= self._retry_at and self._client.service_is_ready():
            self._futures.append(self._client.call_async(self._content))
            self._retry_at = now + self._retry_s
        return next((future.result() for future in self._futures if future.done()), None)

    def close(self) -> None:
        """Ignore further answers."""
        for future in self._futures:
            self._client.remove_pending_request(future)


class Call:
    """The service call of one operator command.

    A stop and a pause are repeated until they are answered. The others are sent once: a repeated `arm` could arm a gate
    that has stopped in the meantime, and a repeated `start` or `veto` could affect the next episode. Before such a
    command, the call sends a harmless request from a second client, which was created later. A node discovers clients
    in the order of their creation. If it answers the second client, it can therefore also answer the first one.

    Args:
        command: a key of `SERVICES`.
        client: client of the command's service.
        greeter: client of the same node's ``list_parameters`` service, created after ``client``.

    Attributes:
        command: as above.
        answer: the response of the service; None until it arrives.
        failure: why there will be no answer; empty while there may be one.
        is_found: whether the node has been found.
    """

    def __init__(self, command: str, client: Client, greeter: Client) -> None:
        self.command = command
        self.answer: Any = None
        self.failure = ""
        self.is_found = False
        self._main = Request(client, SERVICES[command][2], RETRY_S if command in REPEATED else inf)
        greeting = Request(greeter, ListParameters.Request(), RETRY_S)
        self._requests = deque([self._main] if command in REPEATED else [greeting, self._main])
        self._deadline = inf

    @property
    def is_over(self) -> bool:
        """Whether the call has been answered or has failed."""
        return self.answer is not None or bool(self.failure)

    @property
    def text(self) -> str:
        """The state of the call in one line."""
        if self.answer is None:
            return f"{self.command}: {self.failure or 'requested'}"
        outcome = "done" if self.answer.success else "refused"
        return f"{self.command}: {outcome}" + f" ({self.answer.message})" * bool(self.answer.message)

    def proceed(self, now: float) -> None:
        """Send the due request, and store its answer.

        Args:
            now: monotonic time, seconds.
        """
        if self._deadline == inf:
            self._deadline = now + FOUND_TIMEOUT_S
        request = self._requests[0]
        answer = request.answer(now)
        if request.is_sent and not self.is_found:
            self.is_found, self._deadline = True, now + ANSWER_TIMEOUT_S
        if answer is not None:
            request.close()
            self._requests.popleft()
            self.answer = None if self._requests else answer
        elif now > self._deadline:
            request.close()
            self.failure = self._silence()

    def _silence(self) -> str:
        if not self.is_found:
            return "the node is not running"
        return "the node does not answer" + "; it may have acted, see rkhs status" * self._main.is_sent


class OperatorCalls:
    """The calls of a node that forwards an operator's commands.

    Owns the clients, a queue of calls for each called node, and the newest call.

    Args:
        node: makes the calls; the caller must spin its executor.
        commands: keys of `SERVICES`; clients exist only for these.

    Attributes:
        newest: the newest call; None before the first.
    """

    def __init__(self, node: Node, commands: Iterable[str]) -> None:
        self.newest: Call | None = None
        services = {command: SERVICES[command] for command in commands}
        self._clients = {command: node.create_client(kind, service) for command, (service, kind, _) in services.items()}
        names = {command: service.partition("/")[0] for command, (service, _, _) in services.items()}
        greeters = {name: node.create_client(ListParameters, f"{name}/list_parameters") for name in names.values()}
        self._greeters = {command: greeters[name] for command, name in names.items()}
        queues: dict[str, deque[Call]] = {name: deque() for name in names.values()}
        self._queues = {command: queues[name] for command, name in names.items()}

    def call(self, command: str) -> Call:
        """Enqueue the call of a command."""
        call = self.newest = Call(command, self._clients[command], self._greeters[command])
        self._queues[command].append(call)
        return call

    def proceed(self) -> None:
        """Advance the first call to each node."""
        now = time.monotonic()
        for queue in self._queues.values():
            while queue and queue[0].is_over:
                queue.popleft()
            if queue:
                queue[0].proceed(now)
