"""The status node of ``rkhs status``: shows a table of the nodes at work, from what they report."""

from __future__ import annotations

import time
from collections.abc import Iterator
from threading import Event

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rich.console import Console
from rich.table import Table
from rich.text import Text

from rkhs_ros.base.validation import shown
from rkhs_ros.nodes.diagnostics import DIAGNOSTICS_QOS, REPORT_PERIOD_S, TOPIC
from rkhs_ros.nodes.spin import SIGNAL_CHECK_S, PeerError, run

LISTEN_S = 3 * REPORT_PERIOD_S  # without word of another node, after which all are taken to have reported
COLUMNS = {  # of what is reported: their heads, which leave a terminal of 80 characters room for all
    "serving version": "policy",
    "batch": "batch",
    "step": "step",
    "steps per second": "steps\nper s",
    "refusals": "refused",
    "passed over": "passed\nover",
    "restarts": "started\nagain",
}
LAST_REFUSAL = "last refusal"
OF_OURS = "passed over"  # that all our nodes report
RANDOM = ("serving version", "batch")  # numbers that say no more than which are the same
DIGITS = 4  # of these
COLOURS = {DiagnosticStatus.OK: "green", DiagnosticStatus.WARN: "yellow", DiagnosticStatus.ERROR: "red"}


class StatusNode(Node):
    """Listens to what the nodes report.

    Owns the newest report of each, and when a node was heard for the first time.
    """

    def __init__(self) -> None:
        """Open the topic."""
        super().__init__("status")
        self.heard: dict[str, DiagnosticStatus] = {}
        self.heard_new_at = time.monotonic()
        self.create_subscription(DiagnosticArray, TOPIC, self._hear, DIAGNOSTICS_QOS)

    def _hear(self, message: DiagnosticArray) -> None:
        ours = [status for status in message.status if OF_OURS in {value.key for value in status.values}]
        if {status.name for status in ours} - set(self.heard):
            self.heard_new_at = time.monotonic()
        self.heard |= {status.name: status for status in ours}


def table(statuses: dict[str, DiagnosticStatus]) -> Table:
    """Return the reports, a node a row."""
    result = Table(box=None, pad_edge=False, collapse_padding=True)
    for head in ("node", "state", *COLUMNS.values()):
        wraps = head in ("state", "batch", "step")
        result.add_column(head, overflow="fold", no_wrap=not wraps, min_width=len(head) if wraps else None)
    for name, status in sorted(statuses.items()):
        values = _values(status)
        state = Text(shown(status.message), COLOURS.get(status.level, "red"))
        result.add_row(Text(shown(name)), state, *(Text(_cell(key, values.get(key, ""))) for key in COLUMNS))
    return result


def reasons(statuses: dict[str, DiagnosticStatus]) -> Iterator[Text]:
    """Yield why a node last refused a message or passed it over, a line for each that did."""
    for name, status in sorted(statuses.items()):
        if reason := _values(status).get(LAST_REFUSAL):
            yield Text(f"{shown(name)} last refused or passed over {shown(reason)}")


def _values(status: DiagnosticStatus) -> dict[str, str]:
    return {value.key: value.value for value in status.values}


def _cell(key: str, value: str) -> str:
    """Return a value as it is shown: of random numbers the last digits."""
    return " ".join(number[-DIGITS:] for number in shown(value).split()) if key in RANDOM else shown(value)


def show(node: StatusNode, stop: Event) -> None:
    """Listen until no more nodes are heard of, and print what they reported.

    Raises:
        PeerError: nobody reported.
    """
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    while time.monotonic() < node.heard_new_at + LISTEN_S and not stop.is_set():
        executor.spin_once(timeout_sec=SIGNAL_CHECK_S)
    if not node.heard:
        raise PeerError(
            f"expected nodes at work, got none within {LISTEN_S:g} s; name their run's folder, or set ROS_DOMAIN_ID"
        )
    Console().print(table(node.heard), *reasons(node.heard), sep="\n")


def main() -> None:
    """Run the status node."""
    run(StatusNode, "status", show)


if __name__ == "__main__":
    main()
