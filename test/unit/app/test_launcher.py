import os
import signal
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager
from itertools import count
from pathlib import Path
from types import CodeType, FrameType, SimpleNamespace
from typing import Any, cast

import pytest

import rkhs_ros
from rkhs_ros.app.launcher import (
    DOMAIN,
    MOST_RESUMES,
    WINDOW_S,
    NodeProcess,
    _signals_passed_to,
    domain_of,
    reserved_domain,
    resuming,
    write_parameters,
)
from rkhs_ros.base.endings import BAD_INPUT, FAILED, INTERRUPTED, RESUMABLE, deferred_signals
from rkhs_ros.base.files import locked
from rkhs_ros.base.yaml_text import dumped, loaded
from rkhs_ros.runs.config import config_for

CONFIG = config_for("x", horizon=10)


@pytest.mark.parametrize(
    "path", ["a #b", "a: b", "{x}", " trailing \n line ", "1e5", "on", "é \U0001f600 \\ \"'", "*a"]
)
def test_the_parameter_file_transports_any_path_and_the_settings_of_all_nodes(tmp_path: Path, path: str) -> None:
    file = write_parameters(CONFIG, tmp_path / "parameters.yaml", output=path, resume=True)
    document = loaded(file.read_text())
    assert document["/**/simulator"]["ros__parameters"] == {"environment": {"id": "x"}}
    settings = loaded(dumped(CONFIG.parameters()))["/**/learner"]["ros__parameters"]
    more = {"environment": {"id": "x"}, "output": path, "resume": True}
    assert document["/**/learner"]["ros__parameters"] == settings | more


def signalled_at(code: CodeType, instruction: int, enter: Callable[[], AbstractContextManager[Any]]) -> bool:
    """Raise SIGTERM at an instruction of a context manager during its entry; return whether the instruction exists."""
    executed = 0

    def trace(frame: FrameType, event: str, arg: object) -> object:
        nonlocal executed
        if frame.f_code is code:
            frame.f_trace_opcodes = True
            is_next = event in ("opcode", "line")  # Python 3.12 reports lines only
            executed += is_next
            if is_next and executed == instruction:
                signal.raise_signal(signal.SIGTERM)
        return trace

    before = sys.gettrace()
    sys.settrace(trace)
    try:
        with enter():
            sys.settrace(before)
    finally:
        sys.settrace(before)
    return executed >= instruction


@pytest.mark.parametrize("manager", ["held", "passed on"])
def test_a_signal_at_any_instruction_interrupts_and_restores_the_handlers(manager: str) -> None:
    interrupts = []
    process = SimpleNamespace(poll=lambda: None)
    learner = cast(NodeProcess, SimpleNamespace(process=process, interrupt=lambda: interrupts.append(1)))
    enter = deferred_signals if manager == "held" else lambda: _signals_passed_to(learner)
    wrapped: Any = deferred_signals if manager == "held" else _signals_passed_to
    handlers = [signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)]
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    raised = 0
    try:
        for instruction in count(1):
            try:
                if not signalled_at(wrapped.__wrapped__.__code__, instruction, enter):
                    break
            except KeyboardInterrupt:
                raised += 1
            assert signal.getsignal(signal.SIGTERM) is signal.default_int_handler
    finally:
        signal.signal(signal.SIGTERM, handlers[1])
    assert signal.getsignal(signal.SIGINT) is handlers[0]
    assert raised + len(interrupts) == instruction - 1
    assert raised > 0
    assert manager == "held" or interrupts


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


@pytest.fixture
def undecided(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv(DOMAIN, raising=False)


@pytest.mark.usefixtures("undecided")
def test_parallel_runs_have_distinct_domains_in_their_folders(tmp_path: Path) -> None:
    one, other = tmp_path / "one", tmp_path / "other"
    one.mkdir()
    other.mkdir()
    with reserved_domain(one):
        assert domain_of(one) == int(os.environ.pop(DOMAIN))
        with reserved_domain(other):
            assert domain_of(other) == int(os.environ[DOMAIN]) != domain_of(one)
        os.environ[DOMAIN] = ""  # removed at the end
    assert DOMAIN not in os.environ
    (other / "domain").write_text("7\n")  # as after a SIGKILL; another robot may use the domain by now
    for folder in (one, other):
        with pytest.raises(ValueError, match="expected the folder of an active run over topics, got none"):
            domain_of(folder)


@pytest.mark.usefixtures("undecided")
def test_a_rejected_run_preserves_the_domain_of_the_active_one(tmp_path: Path) -> None:
    with reserved_domain(tmp_path):
        domain = domain_of(tmp_path)
        with (
            locked(tmp_path),  # like the learner of the run
            pytest.raises(ValueError, match="expected a free run folder, got one in use by another process"),
            reserved_domain(tmp_path),
        ):
            pass
        assert domain_of(tmp_path) == domain
        with pytest.raises(ValueError, match="expected a folder that no other run uses, got one whose nodes start"):
            rkhs_ros.train("rkhs/Toy-v0", out=tmp_path, iterations=1)
