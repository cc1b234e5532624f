"""A run is resumed after faults, at most five times in five minutes or without a further iteration."""

import time
from collections.abc import Iterator
from itertools import count

import pytest

from rkhs_ros.app.launcher import MOST_RESUMES, WINDOW_S, resuming
from rkhs_ros.base.endings import BAD_INPUT, FAILED, INTERRUPTED, RESUMABLE


class Run:
    """A run that ends with the given codes, one after the other, after some time and with further iterations."""

    def __init__(self, codes: Iterator[int], seconds: float, iterations: int) -> None:
        self.begun = 0
        self.now = 0.0
        self._codes, self._seconds, self._iterations = codes, seconds, iterations

    def run(self) -> int:
        self.begun += 1
        self.now += self._seconds
        return next(self._codes)

    def stored(self) -> int:
        return self._iterations * self.begun


@pytest.fixture
def ended(monkeypatch: pytest.MonkeyPatch):
    def end(codes: Iterator[int], seconds: float = 1.0, iterations: int = 1) -> tuple[int, int]:
        run = Run(codes, seconds, iterations)
        monkeypatch.setattr(time, "monotonic", lambda: run.now)
        return resuming(run.run, run.stored), run.begun

    return end


@pytest.mark.parametrize("code", [0, FAILED, BAD_INPUT, INTERRUPTED])
def test_only_faults_of_nodes_are_resumed(ended, capsys: pytest.CaptureFixture[str], code: int) -> None:
    assert ended(iter([code])) == (code, 1)
    assert ended(iter([RESUMABLE, RESUMABLE, code])) == (code, 3)
    warnings = [f"warning: the run resumes after iteration {k} ({k} of at most 5 times within 300 s)" for k in (1, 2)]
    assert capsys.readouterr().err.splitlines() == warnings


def test_too_many_faults_in_a_short_time_end_the_run(ended, capsys: pytest.CaptureFixture[str]) -> None:
    assert ended(RESUMABLE for _ in count()) == (FAILED, 1 + MOST_RESUMES)
    last = "error: the run was resumed 5 times within 300 s or without a further iteration"
    assert capsys.readouterr().err.splitlines()[-1] == last


def test_rare_faults_end_a_run_only_if_it_gets_no_further(ended) -> None:
    often = [RESUMABLE] * 3 * MOST_RESUMES + [0]
    assert ended(iter(often), seconds=WINDOW_S / MOST_RESUMES)[0] == 0
    assert ended(iter(often), seconds=WINDOW_S, iterations=0) == (FAILED, 1 + MOST_RESUMES)
