"""Stop requests by signals."""

import signal
from collections.abc import Iterator
from pathlib import Path

import pytest

from rkhs_ros.base.endings import ENDING, Stop, StoppedError
from rkhs_ros.base.user_code import call_user_function, user_module

OUR = signal.SIGUSR1


@pytest.fixture
def stop() -> Iterator[Stop]:
    stop = Stop()
    before = signal.signal(OUR, lambda number, frame: stop.set())
    yield stop
    signal.signal(OUR, before)


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


def test_a_request_interrupts_the_import_of_user_code(
    stop: Stop, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.syspath_prepend(tmp_path)
    (tmp_path / "slow_prior.py").write_text(f"import signal\nsignal.raise_signal({int(OUR)})\n")
    with pytest.raises(StoppedError), stop.interrupting():
        user_module("slow_prior", "")


def test_a_termination_interrupts_user_code_also_if_the_shell_ignores_ctrl_c() -> None:
    before = [(number, signal.getsignal(number)) for number in ENDING]
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        with pytest.raises(KeyboardInterrupt):
            call_user_function(lambda: signal.raise_signal(signal.SIGTERM))
    finally:
        for number, handler in before:
            signal.signal(number, handler)
