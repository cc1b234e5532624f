"""The monitor node of ``rkhs view``: prints the reports of nodes and gate, and forwards the operator's commands."""

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

COMMANDS = ("start", "pause", "stop", "veto")  # never "arm": these cannot move a robot that the operator has not armed
SILENT_S = 3 * REPORT_PERIOD_S  # without a report, after which a node counts as silent
PRINT_PERIOD_S = 0.3  # least time between lines
POLL_S = 0.05  # between checks for commands
COMMAND_BYTES = 4096
LEVELS = {DiagnosticStatus.OK: "ok", DiagnosticStatus.WARN: "warning", DiagnosticStatus.ERROR: "error"}
SILENT = "silent"


class MonitorNode(Node):
    """Subscribes to the reports of nodes and gate, and calls the services of the operator's commands.

    Owns the newest reports, and the calls. It has no client of the service that arms the gate.
    """

    def __init__(self) -> None:
        """Open the topics."""
        super().__init__("monitor")
        self._heard: dict[str, tuple[DiagnosticStatus, float]] = {}
        self._gate: GateState | None = None
        self.calls = OperatorCalls(self, COMMANDS)
        self.create_subscription(DiagnosticArray, TOPIC, self._hear, DIAGNOSTICS_QOS)
        self.create_subscription(GateState, "gate/state", self._hear_gate, LATCHED_QOS)

    def report(self) -> dict[str, Any]:
        """Return the reports as one line's content."""
        now = time.monotonic()
        nodes = [
            [name, SILENT, ""] if now - at > SILENT_S else [name, LEVELS.get(each.level, "error"), each.message]
            for name, (each, at) in sorted(self._heard.items())
        ]
        fields = () if self._gate is None else self._gate.get_fields_and_field_types()
        gate = {name: getattr(self._gate, name) for name in fields} or None
        call = self.calls.newest  # late answers to older calls are ignored
        return {"nodes": nodes, "gate": gate, "answer": call.text if call else ""}

    def _hear(self, message: DiagnosticArray) -> None:
        self._heard |= {status.name: (status, time.monotonic()) for status in message.status}

    def _hear_gate(self, message: GateState) -> None:
        self._gate = message


def monitor(node: MonitorNode, stop: Stop) -> None:
    """Print a line of JSON for each change, and read commands from standard input, until it is closed."""
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    printed, due = None, 0.0
    while not stop.is_set():
        executor.spin_once(timeout_sec=POLL_S)
        if select.select([sys.stdin], [], [], 0.0)[0]:
            received = os.read(sys.stdin.fileno(), COMMAND_BYTES)
            if not received:
                return
            for command in received.decode(errors="replace").split():
                if command in COMMANDS:
                    node.calls.call(command)
        node.calls.proceed()
        if time.monotonic() >= due and (report := node.report()) != printed:
            printed, due = report, time.monotonic() + PRINT_PERIOD_S
            print(json.dumps(report), flush=True)


def main() -> None:
    """Run the monitor node."""
    run(MonitorNode, "monitor", monitor)


if __name__ == "__main__":
    main()
