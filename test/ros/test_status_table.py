"""The status table prints the reports of other nodes literally, whatever they contain."""

from io import StringIO

import pytest
from diagnostic_msgs.msg import DiagnosticStatus, KeyValue
from rich.console import Console

from rkhs_interfaces.msg import LearningProgress
from rkhs_ros.nodes.watch import COLUMNS, LAST_REFUSAL, MODE, heading, problems, table


@pytest.mark.parametrize("text", ["[/red]", "a\x1b[31mb\x1b]0;title\x07", "two\nlines"])
def test_markup_and_escapes_are_printed_as_text(text: str) -> None:
    status = DiagnosticStatus(name=text, message=text, level=b"\x07")
    status.values = [KeyValue(key=key, value=text) for key in (*COLUMNS, LAST_REFUSAL)]
    out = StringIO()
    Console(file=out, width=20_000).print(table({text: status}), *problems({text: status}), sep="\n")
    shown = out.getvalue()
    assert not set(shown) & set("\x1b\x07")
    assert text[:6].split("\n")[0].split("\x1b")[0] in shown
    assert len(shown.splitlines()) == 3  # headers, the node, its reason


def test_problems_are_listed_below_the_table() -> None:
    why = "no simulator makes a step, and much more is to be said of this than any column has room for"
    values = dict.fromkeys(COLUMNS, "1000")
    source = "/joint_sates: no messages, no publishers; topics of sensor_msgs/msg/JointState: /joint_states"
    gate = {MODE: "stopped", "ignored": "0", LAST_REFUSAL: "a command", "source joints": source}
    known = {  # as gate and simulated robot report: some of the columns, and what they do
        "/gate": (b"\2", f"stopped: {why}", gate),
        "/simulated_robot": (b"\0", "ok", {"ignored": "0"}),
        "/robot": (b"\1", "waiting: for an operator", values | {MODE: "getting ready"}),
    }
    statuses = {
        name: DiagnosticStatus(
            name=name, level=level, message=message, values=[KeyValue(key=k, value=v) for k, v in about.items()]
        )
        for name, (level, message, about) in known.items()
    }
    Console(file=(out := StringIO()), width=80).print(table(statuses))
    assert [line.split()[:3] for line in out.getvalue().splitlines() if line.startswith("/")] == [
        ["/gate", "stopped", "0"],
        ["/robot", "waiting,", "getting"],
        ["/simulated_robot", "ok", "0"],
    ]
    assert [str(line) for line in problems(statuses)] == [
        f"/gate stopped: {why}",
        f"/gate joints: {source}",
        "/gate last refused or ignored a command",
        "/robot waiting: for an operator",
    ]


def test_the_heading_states_the_progress_of_the_run() -> None:
    progress = LearningProgress(run="mine", folder="/results/" + 30 * "long/" + "mine", iteration=3, iterations=40)
    progress.exploration_return, progress.seconds_left = 1.5, 12.0
    progress.last_evaluation_returns = [2.0, 2.5, float("nan")]  # the last iteration was not measured
    progress.model_return = float("nan")
    assert str(heading(progress)).splitlines() == [
        "mine: iteration 3 of 40, 0 episodes, 0 centres, about 12 s left",
        "return 1.5, evaluation 2.5",
        f"in {progress.folder}",
    ]
