import signal
import sys
from collections.abc import Callable
from contextlib import AbstractContextManager
from itertools import count
from pathlib import Path
from types import CodeType, FrameType, SimpleNamespace
from typing import Any, cast

import pytest

from rkhs_ros.app.launcher import NodeProcess, _signals_passed_to, write_parameters
from rkhs_ros.base.endings import deferred_signals
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
