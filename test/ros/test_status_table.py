"""What others report is shown as it is, whatever is in it."""

from io import StringIO

import pytest
from diagnostic_msgs.msg import DiagnosticStatus, KeyValue
from rich.console import Console

from rkhs_ros.nodes.status_node import COLUMNS, LAST_REFUSAL, reasons, table


@pytest.mark.parametrize(
    "text", ["[/red]", "[bold]x", "a\x1b[31mb\x1b]0;title\x07", "two\nlines", "x" * 10_000, ":smile:"]
)
def test_markup_and_escapes_of_others_are_shown_as_text(text: str) -> None:
    status = DiagnosticStatus(name=text, message=text, level=b"\x07")
    status.values = [KeyValue(key=key, value=text) for key in (*COLUMNS, LAST_REFUSAL)]
    out = StringIO()
    Console(file=out, width=20_000).print(table({text: status}), *reasons({text: status}), sep="\n")
    shown = out.getvalue()
    assert not set(shown) & set("\x1b\x07")
    assert text[:6].split("\n")[0].split("\x1b")[0] in shown
    assert len(shown.splitlines()) == 4  # two of the head, the node, its reason


def test_a_run_of_two_simulators_in_a_namespace_is_shown_whole_in_80_characters() -> None:
    random, values = "1234567890123456789", dict.fromkeys(COLUMNS, "1000")
    alone = values | {"serving version": random, "batch": random}
    both = values | {"serving version": random, "batch": f"{random} {random}", "step": "100 100"}
    nodes = {"/learner": both, "/policy": both, "/lab/simulator_1/simulator": alone}
    statuses = {
        name: DiagnosticStatus(name=name, message="well", values=[KeyValue(key=k, value=v) for k, v in known.items()])
        for name, known in nodes.items()
    }
    out = StringIO()
    Console(file=out, width=80).print(table(statuses))
    words = out.getvalue().split()
    assert set(nodes) <= set(words)
    assert {word for head in COLUMNS.values() for word in head.split()} <= set(words)
    assert words.count(random[-4:]) == 8
    assert "…" not in out.getvalue()
