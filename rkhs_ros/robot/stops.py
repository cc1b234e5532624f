"""The stops that are requested on a topic, of which each publisher is heard by itself."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass, field, replace
from typing import NamedTuple

from rkhs_ros.robot.gate_state import STOP_ASKED


class StopRequest(NamedTuple):
    """The newest message of a publisher.

    Attributes:
        is_stop: what it says.
        number: of the message, which grows with each of a publisher.
        heard_at: monotonic time, seconds.
    """

    is_stop: bool
    number: int
    heard_at: float


@dataclass(frozen=True)
class Stops:
    """The newest message of each publisher of a topic: a stop holds until the publisher that requested it clears it.

    Attributes:
        topic: its name, for messages.
        timeout: seconds of silence of a publisher, or of all, that mean stop; 0 if silence means nothing.
        words: by publisher. One that is gone stays, with what it said last, until `without_gone`.
    """

    topic: str
    timeout: float = 0.0
    words: Mapping[bytes, StopRequest] = field(default_factory=dict)

    def heard(self, publisher: bytes, word: StopRequest) -> Stops:
        """Take a message, unless it came before, as one that is heard through two subscriptions."""
        last = self.words.get(publisher)
        if last is not None and word.number <= last.number:
            return self
        return replace(self, words={**self.words, publisher: word})

    def without_gone(self, present: Collection[bytes]) -> Stops:
        """Forget publishers that are gone, at the word of a person who arms the gate."""
        return replace(self, words={each: word for each, word in self.words.items() if each in present})

    def reason(self, now: float, names: Mapping[bytes, str]) -> str:
        """Return in words who requests a stop, or is silent for too long; empty if nobody.

        Args:
            now: monotonic time, seconds.
            names: of the publishers' nodes, as far as they are known.
        """
        on = f"{STOP_ASKED} on the topic '{self.topic}'"
        if asking := [each for each, word in self.words.items() if word.is_stop]:
            return f"{on} by {_listed(asking, names)}"
        if not self.timeout:
            return ""
        silent = [each for each, word in self.words.items() if now - word.heard_at > self.timeout]
        if silent or not self.words:
            return f"{on} by the silence of {_listed(silent, names) or 'everybody'} (stop_timeout {self.timeout:g} s)"
        return ""


def _listed(publishers: Iterable[bytes], names: Mapping[bytes, str]) -> str:
    return ", ".join(sorted({names.get(each, "an unknown node") for each in publishers}))
