"""Stop requests on a topic, tracked separately for each publisher."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass, field, replace
from typing import NamedTuple

from rkhs_ros.robot.gate_state import STOP_REQUESTED


class StopRequest(NamedTuple):
    """The newest message of a publisher.

    Attributes:
        is_stop: whether it requests a stop.
        number: of the message; increases with each message of a publisher.
        heard_at: monotonic time of arrival, seconds.
    """

    is_stop: bool
    number: int
    heard_at: float


@dataclass(frozen=True)
class Stops:
    """The newest message of each publisher of a topic; a stop holds until its own publisher clears it.

    Attributes:
        topic: its name, for messages.
        timeout: seconds of silence of any publisher, or without a publisher, that mean stop; 0 for no timeout.
        requests: newest message by publisher, also of departed publishers until `without_departed`.
    """

    topic: str
    timeout: float = 0.0
    requests: Mapping[bytes, StopRequest] = field(default_factory=dict)

    def with_request(self, publisher: bytes, request: StopRequest) -> Stops:
        """Return the stops after a message; ignore one that has arrived before, through another subscription."""
        last = self.requests.get(publisher)
        if last is not None and request.number <= last.number:
            return self
        return replace(self, requests={**self.requests, publisher: request})

    def without_departed(self, present: Collection[bytes]) -> Stops:
        """Remove publishers that no longer exist, which only an operator who arms the gate may do."""
        return replace(self, requests={each: request for each, request in self.requests.items() if each in present})

    def reason(self, now: float, names: Mapping[bytes, str]) -> str:
        """Return which nodes request a stop or have been silent for too long; empty if none.

        Args:
            now: monotonic time, seconds.
            names: of the publishers' nodes, as far as they are known.
        """
        on_topic = f"{STOP_REQUESTED} on the topic '{self.topic}'"
        if requesting := [each for each, request in self.requests.items() if request.is_stop]:
            return f"{on_topic} by {_listed(requesting, names)}"
        if not self.timeout:
            return ""
        silent = [each for each, request in self.requests.items() if now - request.heard_at > self.timeout]
        if silent or not self.requests:
            by = f"the silence of {_listed(silent, names) or 'all publishers'}"
            return f"{on_topic} by {by} (stop_timeout {self.timeout:g} s)"
        return ""


def _listed(publishers: Iterable[bytes], names: Mapping[bytes, str]) -> str:
    return ", ".join(sorted({names.get(each, "an unknown node") for each in publishers}))
