"""Stop requests, per publisher."""

import pytest

from rkhs_ros.robot.stops import StopRequest, Stops

A, B = b"a", b"b"
NAMES = {A: "/a", B: "/b"}


def after(*messages: tuple[bytes, bool, int], timeout: float = 0.0) -> Stops:
    """Return the stops after messages a second apart: publisher, whether it requests a stop, and number."""
    stops = Stops("stop", timeout)
    for second, (publisher, is_stop, number) in enumerate(messages):
        stops = stops.with_request(publisher, StopRequest(is_stop, number, float(second)))
    return stops


@pytest.mark.parametrize(
    ("messages", "by"),
    [
        ([], ""),
        ([(A, True, 1)], "/a"),
        ([(A, True, 1), (A, False, 2)], ""),
        ([(A, True, 1), (B, False, 9)], "/a"),
        ([(A, True, 1), (B, True, 1), (A, False, 2)], "/b"),
        ([(A, True, 1), (A, False, 2), (A, True, 1)], ""),  # the first one again, through another subscription
        ([(A, True, 3), (A, False, 2)], "/a"),  # out of order, as without acknowledgements
        ([(b"c", True, 1)], "an unknown node"),
    ],
)
def test_a_stop_holds_until_its_publisher_clears_it(messages: list[tuple[bytes, bool, int]], by: str) -> None:
    reason = after(*messages).reason(10.0, NAMES)
    assert reason == (f"a stop is requested on the topic 'stop' by {by}" if by else "")


def test_a_departed_publisher_counts_until_the_gate_is_armed() -> None:
    stops = after((A, True, 1), (B, True, 1))
    assert stops.reason(1e9, NAMES).endswith("by /a, /b")
    assert stops.without_departed({B}).reason(1e9, NAMES).endswith("by /b")
    assert stops.without_departed(set()).reason(1e9, NAMES) == ""


def test_with_a_timeout_silence_of_any_or_all_publishers_is_a_stop() -> None:
    stops = after((A, False, 1), (B, False, 1), timeout=1.5)
    assert stops.reason(1.4, NAMES) == ""
    assert "by the silence of /a (stop_timeout 1.5 s)" in stops.reason(1.6, NAMES)
    assert "by the silence of /a, /b" in stops.reason(9.0, NAMES)
    assert stops.without_departed({B}).reason(1.6, NAMES) == ""
    assert "by the silence of all publishers" in stops.without_departed(set()).reason(1.6, NAMES)
    assert stops.with_request(A, StopRequest(True, 2, 1.6)).reason(9.0, NAMES).endswith("by /a")
