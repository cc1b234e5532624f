"""A connection to a robot that delays and loses messages."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterator
from typing import Generic, TypeVar

import numpy as np

T = TypeVar("T")


class Wire(Generic[T]):
    """One direction of a connection, which delays or loses messages and preserves their order.

    Owns its random stream, the messages in transit and the number of lost ones. The fate of the k-th message depends
    only on the stream and k.

    Args:
        stream: source of two random numbers per message.
        latency: least delay, seconds.
        jitter: greatest additional delay, uniformly distributed, seconds.
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
        """Arrival time of the next message, seconds; infinity if none is in transit."""
        return self._under_way[0][0] if self._under_way else math.inf

    def send(self, time: float, message: T) -> None:
        """Send a message at the given time in seconds; it may be lost."""
        fate, delay = self._stream.random(2)
        if fate < self._loss:
            self.lost += 1
            return
        self._last_arrival = max(self._last_arrival, time + self._latency + self._jitter * delay)
        self._under_way.append((self._last_arrival, message))

    def arrived(self, time: float) -> Iterator[tuple[float, T]]:
        """Remove and yield the messages that have arrived by a time, each with its arrival time."""
        while self._under_way and self.next_arrival <= time:
            yield self._under_way.popleft()
