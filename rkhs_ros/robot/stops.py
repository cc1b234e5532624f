"""Stop requests on a topic that one node publishes on."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from math import inf

from rkhs_ros.robot.gate_state import STOP_REQUESTED

Publishers = Mapping[bytes, str]  # names of their nodes by the identifiers of the publishers


@dataclass(frozen=True)
class StopRequests:
    """The stop requests on a topic.

    A message arrives through each subscription that matches its publisher: in order, but not at the same time, and
    through some perhaps never. A request therefore stands until it is cleared on each subscription that received it. A
    message does not name its publisher, so none clears a request while the topic has more than one.

    Attributes:
        topic: its name, for messages.
        timeout: seconds without a message that mean stop; 0 for no timeout.
        publishers: of the topic, at present.
        requests: subscriptions whose newest message requests a stop, with the publishers that may have sent it.
        heard_at: monotonic time of the newest message, seconds.
    """

    topic: str
    timeout: float = 0.0
    publishers: Publishers = field(default_factory=dict)
    requests: Mapping[int, Publishers] = field(default_factory=dict)
    heard_at: float = -inf

    def heard(self, subscription: int, now: float, *, is_stop: bool) -> StopRequests:
        """Return the requests after a message, which arrived through one of the subscriptions."""
        requests = dict(self.requests)
        if is_stop:
            requests[subscription] = self.publishers
        elif len(self.publishers) < 2:
            requests.pop(subscription, None)
        return replace(self, requests=requests, heard_at=now)

    def without_departed(self) -> StopRequests:
        """Remove requests whose publishers have all left, which only an operator who arms the gate may do."""
        present = {each: senders for each, senders in self.requests.items() if senders.keys() & self.publishers.keys()}
        return replace(self, requests=present)

    def reason(self, now: float) -> str:
        """Return why the robot must stop; empty if it need not.

        Args:
            now: monotonic time, seconds.
        """
        on_topic = f"{STOP_REQUESTED} on the topic '{self.topic}'"
        if self.requests:
            senders = [
                self.publishers.get(each, name) for all_ in self.requests.values() for each, name in all_.items()
            ]
            return f"{on_topic} by {_listed(senders, ' or ') or 'a node that has left'}"
        if len(self.publishers) > 1:
            return f"{on_topic} by more than one publisher: {_listed(self.publishers.values(), ', ')}"
        if self.timeout and now - self.heard_at > self.timeout:
            silent = _listed(self.publishers.values(), ", ") or "all nodes"
            return f"{on_topic} by the silence of {silent} (stop_timeout {self.timeout:g} s)"
        return ""


def _listed(names: Iterable[str], separator: str) -> str:
    return separator.join(sorted(set(names)))
