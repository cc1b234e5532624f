"""Service calls that an operator decides on: none is lost because nodes have just met, none acts twice."""

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
RETRY_S = 0.5  # without an answer, before a request that may be repeated is sent again
SERVICES: dict[str, tuple[str, Any, Any]] = {  # of each word: the service, its type, and the request
    "arm": ("gate/arm", Trigger, Trigger.Request()),
    "stop": ("gate/stop", Trigger, Trigger.Request()),
    "start": ("robot/start", Trigger, Trigger.Request()),
    "pause": ("robot/pause", SetBool, SetBool.Request(data=True)),
    "veto": ("robot/veto", Trigger, Trigger.Request()),
}
REPEATED = ("stop", "pause")  # twice is as good as once, and both make the robot safer


class Request:
    """A request to one service, sent when the service is there, and again while no answer comes.

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
        """Expect no further answers."""
        for future in self._futures:
            self._client.remove_pending_request(future)


class Call:
    """A word of an operator on its way to the node that acts on it.

    A stop and a pause are repeated until they are answered. The others are sent once: a repeated `arm` could arm a gate
    that has stopped in the meantime, a repeated `start` or `veto` could count for the next episode. So that the answer
    is not lost, a harmless request to the same node goes first: a node learns of clients in the order in which they
    were made, so a node whose answer reaches a later client also reaches the earlier one.

    Args:
        word: a key of `SERVICES`.
        client: of its service.
        greeter: client of the same node's ``list_parameters``, made after the other.

    Attributes:
        word: as above.
        answer: the response of the service; None until it is there.
        failure: why there will be no answer; empty while there may be one.
        is_found: whether the node was there.
    """

    def __init__(self, word: str, client: Client, greeter: Client) -> None:
        self.word = word
        self.answer: Any = None
        self.failure = ""
        self.is_found = False
        self._asked = Request(client, SERVICES[word][2], RETRY_S if word in REPEATED else inf)
        greeting = Request(greeter, ListParameters.Request(), RETRY_S)
        self._requests = deque([self._asked] if word in REPEATED else [greeting, self._asked])
        self._deadline = inf

    @property
    def is_over(self) -> bool:
        """Whether the answer is there, or none is to come."""
        return self.answer is not None or bool(self.failure)

    @property
    def text(self) -> str:
        """What became of the word, in a line."""
        if self.answer is None:
            return f"{self.word}: {self.failure or 'asked'}"
        outcome = "done" if self.answer.success else "refused"
        return f"{self.word}: {outcome}" + f" ({self.answer.message})" * bool(self.answer.message)

    def proceed(self, now: float) -> None:
        """Send what is due, and take what was answered.

        Args:
            now: the monotonic time, seconds.
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
            return "the node is not there"
        return "the node does not answer" + "; it may have acted, see rkhs status" * self._asked.is_sent


class OperatorCalls:
    """The calls of a node that passes on what an operator decides.

    Owns the clients, the calls under way in the order in which they were asked for, for each node that acts on them,
    and the newest call.

    Args:
        node: makes the calls; its executor must be spun by the caller.
        words: keys of `SERVICES`; there are clients of no others.

    Attributes:
        newest: the call that was asked for last; None before the first.
    """

    def __init__(self, node: Node, words: Iterable[str]) -> None:
        self.newest: Call | None = None
        services = {word: SERVICES[word] for word in words}
        self._clients = {word: node.create_client(kind, service) for word, (service, kind, _) in services.items()}
        names = {word: service.partition("/")[0] for word, (service, _, _) in services.items()}
        greeters = {name: node.create_client(ListParameters, f"{name}/list_parameters") for name in names.values()}
        self._greeters = {word: greeters[name] for word, name in names.items()}
        queues: dict[str, deque[Call]] = {name: deque() for name in names.values()}
        self._queues = {word: queues[name] for word, name in names.items()}

    def call(self, word: str) -> Call:
        """Ask for the service of one of the words."""
        call = self.newest = Call(word, self._clients[word], self._greeters[word])
        self._queues[word].append(call)
        return call

    def proceed(self) -> None:
        """Bring the first call to each node further."""
        now = time.monotonic()
        for queue in self._queues.values():
            while queue and queue[0].is_over:
                queue.popleft()
            if queue:
                queue[0].proceed(now)
