"""The monitor node of ``rkhs view``: tells in lines what nodes and gate report, and passes on what a person decides."""

from __future__ import annotations

import json
import os
import select
import sys
import time
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node

from rkhs_interfaces.msg import GateState
from rkhs_ros.base.endings import Stop
from rkhs_ros.nodes.core.diagnostics import DIAGNOSTICS_QOS, REPORT_PERIOD_S, TOPIC
from rkhs_ros.nodes.core.messages import LATCHED_QOS
from rkhs_ros.nodes.core.spin import run
from rkhs_ros.nodes.watch.operator_calls import OperatorCalls

WORDS = ("start", "pause", "stop", "veto")  # that make no robot move that a person has not armed: never "arm"
SILENT_S = 3 * REPORT_PERIOD_S  # without a report, after which a node is told to be silent
TELL_PERIOD_S = 0.3  # between lines at least
POLL_S = 0.05  # between looks at what a person decided
WORD_BYTES = 4096
LEVELS = {DiagnosticStatus.OK: "ok", DiagnosticStatus.WARN: "warning", DiagnosticStatus.ERROR: "error"}
SILENT = "silent"


class MonitorNode(Node):
    """Hears what the nodes and the gate of a run report, and calls the services of a few words.

    Owns the newest reports, and the calls. Has no client of the service that arms the gate.
    """

    def __init__(self) -> None:
        """Open the topics."""
        super().__init__("monitor")
        self._heard: dict[str, tuple[DiagnosticStatus, float]] = {}
        self._gate: GateState | None = None
        self.calls = OperatorCalls(self, WORDS)
        self.create_subscription(DiagnosticArray, TOPIC, self._hear, DIAGNOSTICS_QOS)
        self.create_subscription(GateState, "gate/state", self._hear_gate, LATCHED_QOS)

    def report(self) -> dict[str, Any]:
        """Return what was reported, as it goes into a line."""
        now = time.monotonic()
        nodes = [
            [name, SILENT, ""] if now - at > SILENT_S else [name, LEVELS.get(each.level, "error"), each.message]
            for name, (each, at) in sorted(self._heard.items())
        ]
        fields = () if self._gate is None else self._gate.get_fields_and_field_types()
        gate = {name: getattr(self._gate, name) for name in fields} or None
        call = self.calls.newest  # a late answer to an older one is not shown
        return {"nodes": nodes, "gate": gate, "answer": call.text if call else ""}

    def _hear(self, message: DiagnosticArray) -> None:
        self._heard |= {status.name: (status, time.monotonic()) for status in message.status}

    def _hear_gate(self, message: GateState) -> None:
        self._gate = message


def tell(node: MonitorNode, stop: Stop) -> None:
    """Write a line of JSON for each news, and take a word from each line that is read, until there are no more."""
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    told, due = None, 0.0
    while not stop.is_set():
        executor.spin_once(timeout_sec=POLL_S)
        if select.select([sys.stdin], [], [], 0.0)[0]:
            words = os.read(sys.stdin.fileno(), WORD_BYTES)
            if not words:
                return
            for word in words.decode(errors="replace").split():
                if word in WORDS:
                    node.calls.call(word)
        node.calls.proceed()
        if time.monotonic() >= due and (news := node.report()) != told:
            told, due = news, time.monotonic() + TELL_PERIOD_S
            print(json.dumps(news), flush=True)


def main() -> None:
    """Run the monitor node."""
    run(MonitorNode, "monitor", tell)


if __name__ == "__main__":
    main()
