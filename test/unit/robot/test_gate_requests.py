"""Stop requests on a topic."""

import pytest
from hypothesis import given, strategies as st

from rkhs_ros.robot.gate_state import Publishers, StopRequests

A, B = {b"a": "/a"}, {b"b": "/b"}
Messages = list[tuple[Publishers, bool]]  # who is on the topic, and whether a stop is requested
PREFIX = "a stop is requested on the topic '/stop'"


def after(messages: Messages, publishers: Publishers, timeout: float = 0.0) -> StopRequests:
    """Return the requests after messages a second apart, with these publishers on the topic then."""
    requests = StopRequests("/stop", timeout)
    for second, (present, is_stop) in enumerate(messages):
        requests = StopRequests("/stop", timeout, present, requests.requests, requests.heard_at)
        requests = requests.heard(0, float(second), is_stop=is_stop)
    return StopRequests("/stop", timeout, publishers, requests.requests, requests.heard_at)


@pytest.mark.parametrize(
    ("messages", "publishers", "reason"),
    [
        ([], {}, ""),
        ([(A, True)], A, "by /a"),
        ([(A, True), (A, False)], A, ""),
        ([(A, True), (A, False), (A, True)], A, "by /a"),
        ([(A, True), (A | B, False)], A, "by /a"),  # perhaps by /b
        ([(A | B, True)], A, "by /a or /b"),
        ([(A | B, True), (A, False)], A, ""),
        ([({}, True)], {}, "by a node that has left"),
        ([], A | B, "by more than one publisher: /a, /b"),
    ],
)
def test_a_stop_holds_until_the_only_publisher_clears_it(
    messages: Messages, publishers: Publishers, reason: str
) -> None:
    assert after(messages, publishers).reason(10.0) == (f"{PREFIX} {reason}" if reason else "")


def test_a_request_of_a_departed_publisher_stands_until_the_gate_is_armed() -> None:
    departed = after([(A, True)], B)
    assert departed.reason(1e9) == f"{PREFIX} by /a"
    assert departed.without_departed().reason(1e9) == ""
    assert after([(A | B, True)], B).without_departed().reason(1e9) == f"{PREFIX} by /a or /b"


def test_with_a_timeout_silence_is_a_stop() -> None:
    for publishers, silent in ((A, "/a"), ({}, "all nodes")):
        silence = f"{PREFIX} by the silence of {silent} (stop_timeout 1.5 s)"
        assert after([], publishers, timeout=1.5).reason(0.0) == silence
        beating = after([(A, False)], publishers, timeout=1.5)
        assert beating.reason(1.4) == ""
        assert beating.reason(1.6) == silence


@given(
    messages=st.lists(st.booleans(), max_size=8),
    lost=st.sets(st.integers(0, 7)),
    order=st.lists(st.integers(0, 2), max_size=40),
)
def test_each_request_stops_in_whatever_order_the_subscriptions_deliver(
    messages: list[bool], lost: set[int], order: list[int]
) -> None:
    """Two reliable subscriptions receive all messages and a best-effort one some, each in order."""
    some = [is_stop for number, is_stop in enumerate(messages) if number not in lost]
    queues = [list(messages), list(messages), list(some)]
    requests = StopRequests("/stop", publishers=A)
    for subscription in (*order, *sorted([0, 1, 2] * len(messages))):
        if queues[subscription]:
            is_stop = queues[subscription].pop(0)
            requests = requests.heard(subscription, 0.0, is_stop=is_stop)
            assert requests.reason(0.0) or not is_stop
    assert bool(requests.reason(0.0)) == any(received[-1] for received in (messages, some) if received)
