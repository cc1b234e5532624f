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
from rclpy.task import Future

from rkhs_interfaces.msg import GateState
from rkhs_ros.base.endings import Stop
from rkhs_ros.nodes.diagnostics import DIAGNOSTICS_QOS, REPORT_PERIOD_S, TOPIC
from rkhs_ros.nodes.messages import LATCHED_QOS
from rkhs_ros.nodes.operator_node import SERVICES
from rkhs_ros.nodes.spin import run

WORDS = ("start", "pause", "stop", "veto")  # that make no robot move that a person has not armed: never "arm"
SILENT_S = 3 * REPORT_PERIOD_S  # without a report, after which a node is told to be silent
TELL_PERIOD_S = 0.3  # between lines at least
POLL_S = 0.05  # between looks at what a person decided
WORD_BYTES = 4096
LEVELS = {DiagnosticStatus.OK: "ok", DiagnosticStatus.WARN: "warning", DiagnosticStatus.ERROR: "error"}
SILENT = "silent"


class MonitorNode(Node):
    """Hears what the nodes and the gate of a run report, and calls the services of a few words.

    Owns the newest reports, and what came of the last word. Has no client of the service that arms the gate.
    """

    def __init__(self) -> None:
        """Open the topics."""
        super().__init__("monitor")
        self._heard: dict[str, tuple[DiagnosticStatus, float]] = {}
        self._gate: GateState | None = None
        self._answer = ""
        self.create_subscription(DiagnosticArray, TOPIC, self._hear, DIAGNOSTICS_QOS)
        self.create_subscription(GateState, "gate/state", self._hear_gate, LATCHED_QOS)
        services = {word: SERVICES[word] for word in WORDS}
        self._asked = {word: request for word, (_, _, request) in services.items()}
        self._callers = {word: self.create_client(kind, name) for word, (name, kind, _) in services.items()}

    def report(self) -> dict[str, Any]:
        """Return what was reported, as it goes into a line."""
        now = time.monotonic()
        nodes = [
            [name, SILENT, ""] if now - at > SILENT_S else [name, LEVELS.get(each.level, "error"), each.message]
            for name, (each, at) in sorted(self._heard.items())
        ]
        fields = () if self._gate is None else self._gate.get_fields_and_field_types()
        gate = {name: getattr(self._gate, name) for name in fields} or None
        return {"nodes": nodes, "gate": gate, "answer": self._answer}

    def say(self, word: str) -> None:
        """Call the service of a word; any other is passed over."""
        if word not in self._callers:
            return
        if not self._callers[word].service_is_ready():
            self._answer = f"{word}: the node is not there"
            return
        self._answer = f"{word}: asked"
        future = self._callers[word].call_async(self._asked[word])
        future.add_done_callback(lambda done: self._hear_answer(word, done))

    def _hear_answer(self, word: str, future: Future) -> None:
        answer = future.result()
        told = "done" if answer.success else "refused"
        self._answer = f"{word}: {told}" + f" ({answer.message})" * bool(answer.message)

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
                node.say(word)
        if time.monotonic() >= due and (news := node.report()) != told:
            told, due = news, time.monotonic() + TELL_PERIOD_S
            print(json.dumps(news), flush=True)


def main() -> None:
    """Run the monitor node."""
    run(MonitorNode, "monitor", tell)


if __name__ == "__main__":
    main()
