"""What others report is shown as it is, whatever is in it."""

from io import StringIO

import pytest
from diagnostic_msgs.msg import DiagnosticStatus, KeyValue
from rich.console import Console

from rkhs_ros.nodes.status_node import KEYS, table


@pytest.mark.parametrize(
    "text", ["[/red]", "[bold]x", "a\x1b[31mb\x1b]0;title\x07", "two\nlines", "x" * 10_000, ":smile:"]
)
def test_markup_and_escapes_of_others_are_shown_as_text(text: str) -> None:
    status = DiagnosticStatus(name=text, message=text, level=b"\x07")
    status.values = [KeyValue(key=key, value=text) for key in KEYS]
    out = StringIO()
    Console(file=out, width=20_000).print(table({text: status}))
    shown = out.getvalue()
    assert not set(shown) & set("\x1b\x07")
    assert text[:6].split("\n")[0].split("\x1b")[0] in shown
    assert len(shown.splitlines()) == 5
