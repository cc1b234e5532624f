"""A connection between a robot and others that delays and loses messages."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterator
from typing import Generic, TypeVar

import numpy as np

T = TypeVar("T")


class Wire(Generic[T]):
    """One direction of a connection: messages come late or not at all, and in the order in which they were sent.

    Owns its random stream, what is under way and how much was lost. What happens to the k-th message follows from the
    stream and k alone.

    Args:
        stream: two numbers of it are drawn for each message.
        latency: seconds that each message takes at least.
        jitter: seconds that it takes more at most, uniformly distributed.
        loss: probability that a message is lost.
    """

    def __init__(self, stream: np.random.Generator, latency: float, jitter: float, loss: float) -> None:
        self.lost = 0
        self._stream = stream
        self._latency, self._jitter, self._loss = latency, jitter, loss
        self._under_way: deque[tuple[float, T]] = deque()
        self._last_arrival = -math.inf

    @property
    def next_arrival(self) -> float:
        """When the next message arrives, in seconds; infinity where none is under way."""
        return self._under_way[0][0] if self._under_way else math.inf

    def send(self, time: float, message: T) -> None:
        """Send a message at a time in seconds."""
        fate, delay = self._stream.random(2)
        if fate < self._loss:
            self.lost += 1
            return
        self._last_arrival = max(self._last_arrival, time + self._latency + self._jitter * delay)
        self._under_way.append((self._last_arrival, message))

    def arrived(self, time: float) -> Iterator[tuple[float, T]]:
        """Take out the messages that have arrived by a time, each with the time of its arrival."""
        while self._under_way and self.next_arrival <= time:
            yield self._under_way.popleft()
