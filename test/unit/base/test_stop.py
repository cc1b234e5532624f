"""Stop requests by signals, also if a second signal interrupts the handler of the first."""

import signal
import sys
from collections.abc import Iterator
from types import FrameType

import pytest

from rkhs_ros.base.endings import Stop, StoppedError

OUR, DEADLINE = signal.SIGUSR1, signal.SIGALRM


def too_long(number: int, frame: FrameType | None) -> None:
    raise TimeoutError


@pytest.fixture
def stop() -> Iterator[Stop]:
    stop = Stop()
    before = [signal.signal(OUR, lambda number, frame: stop.set()), signal.signal(DEADLINE, too_long)]
    yield stop
    for number, handler in zip((OUR, DEADLINE), before, strict=True):
        signal.signal(number, handler)


def test_a_signal_may_interrupt_the_handler_at_any_line(stop: Stop) -> None:
    lines = 0

    def trace(frame: FrameType, event: str, arg: object) -> object:
        nonlocal lines
        if event == "line" and lines < 100:
            lines += 1
            signal.raise_signal(OUR)
        return trace

    assert not stop.is_set()
    signal.setitimer(signal.ITIMER_REAL, 5.0)
    before = sys.gettrace()
    sys.settrace(trace)
    try:
        signal.raise_signal(OUR)
    finally:
        sys.settrace(before)
        signal.setitimer(signal.ITIMER_REAL, 0.0)
    assert lines > 0
    assert stop.is_set()


def request(stop: Stop, reached: list[str], *, held: bool) -> None:
    with stop.interrupting():
        with stop.interrupting(not held):
            signal.raise_signal(OUR)
            reached.append("inner")
        reached.append("outer")


@pytest.mark.parametrize(("held", "expected"), [(True, ["inner"]), (False, [])])
def test_the_first_request_interrupts_a_block_unless_it_is_held(stop: Stop, held: bool, expected: list[str]) -> None:
    reached: list[str] = []
    with pytest.raises(StoppedError):
        request(stop, reached, held=held)
    assert reached == expected
    signal.raise_signal(OUR)  # a further request interrupts nothing, so that results are written
