"""What people see of running nodes, and tell them: `rkhs status`, `rkhs robot`, and the reports on a run's page."""

import time
from collections.abc import Iterator
from contextlib import closing, nullcontext
from functools import partial
from math import isnan
from threading import Thread
from typing import Any

import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rclpy.context import Context
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node
from rich.console import Console, Group
from rich.live import Live
from rich.table import Table
from rich.text import Text
from std_srvs.srv import SetBool, Trigger

from rkhs_interfaces.msg import GateState, LearningProgress
from rkhs_ros.base.validation import truncated
from rkhs_ros.nodes.core.diagnostics import DIAGNOSTICS_QOS, PREFIX, REPORT_PERIOD_S, TOPIC
from rkhs_ros.nodes.core.messages import LATCHED_QOS
from rkhs_ros.nodes.core.spin import PeerError
from rkhs_ros.nodes.core.transport import using_udp

LISTEN_S = 3 * REPORT_PERIOD_S  # without a report, after which a node counts as silent
CHECK_S = 0.1  # between checks for new nodes and answers
FOUND_TIMEOUT_S, ANSWER_TIMEOUT_S = 5.0, 10.0  # until a service is found, and from then until it answers
SERVICES: dict[str, tuple[str, Any, Any]] = {  # by command: the service, its type, and the request
    "arm": ("gate/arm", Trigger, Trigger.Request()),
    "stop": ("gate/stop", Trigger, Trigger.Request()),
    "start": ("robot/start", Trigger, Trigger.Request()),
    "pause": ("robot/pause", SetBool, SetBool.Request(data=True)),
    "veto": ("robot/veto", Trigger, Trigger.Request()),
}
OF_OURS = "ignored"  # key that all nodes of this project report
LEVELS = {DiagnosticStatus.OK: "ok", DiagnosticStatus.WARN: "warning"}
PROGRESS = "rkhs_interfaces/msg/LearningProgress"
COLUMNS = {  # headers of the reported values: one line each, and short enough for a terminal of 80 columns
    "serving version": "policy",
    "batch": "batch",
    "step": "step",
    "steps per second": "Hz",
    "refusals": "refused",
    "ignored": "ignored",
}
LAST_REFUSAL = "last refusal"
MODE = "state"  # of a gate or a robot, in addition to the node's status
RANDOM = ("serving version", "batch")  # random identifiers
DIGITS = 4  # printed of an identifier
COLOURS = {DiagnosticStatus.OK: "green", DiagnosticStatus.WARN: "yellow", DiagnosticStatus.ERROR: "red"}
Statuses = dict[str, DiagnosticStatus]


def _joined(name: str, domain: int | None) -> Node:
    """Return a node in a ROS domain, that of ROS_DOMAIN_ID if it is None, with a context of its own."""
    context = Context()
    with using_udp():  # like the nodes of a run
        rclpy.init(args=[], context=context, domain_id=domain)
        return Node(name, context=context)


class NodeReports:
    """Receives the reports of nodes, the progress of learners and the gate's state, in a thread, until it is closed.

    Owns the newest report of each node with its arrival time, and the newest progress of each learner.
    """

    def __init__(self, domain: int | None) -> None:
        self._node = _joined("status", domain)
        self._executor = SingleThreadedExecutor(context=self._node.context)
        self._executor.add_node(self._node)
        self.heard_new_at = time.monotonic()  # when the last new node appeared, seconds
        self.progress: dict[str, LearningProgress] = {}  # of each learner, by topic
        self._heard: dict[str, tuple[float, DiagnosticStatus]] = {}
        self._topics: set[str] = set()
        self._learners: set[str] = set()
        self._gate: GateState | None = None
        self._node.create_subscription(DiagnosticArray, TOPIC, self._hear, DIAGNOSTICS_QOS)
        self._node.create_subscription(GateState, "gate/state", self._hear_gate, LATCHED_QOS)
        self._node.create_timer(CHECK_S, self._look_for_learners)
        self._thread = Thread(target=self._spin, daemon=True)
        self._thread.start()

    @property
    def statuses(self) -> Statuses:
        """The newest report of each node; one that has fallen silent has an error, but a learner then computes."""
        now, known = time.monotonic(), {name: _busy(name) for name in self._learners}
        for name, (at, each) in dict(self._heard).items():
            is_silent = now - at > LISTEN_S
            known[name] = (known.get(name) or _silent(each, now - at)) if is_silent else each
        return known

    def nodes(self) -> list[tuple[str, str, str]]:
        """Return the name, the level ("ok", "warning" or "error") and the message of each node."""
        return [(name, LEVELS.get(each.level, "error"), each.message) for name, each in sorted(self.statuses.items())]

    def gate(self) -> dict[str, Any] | None:
        """Return the fields of the gate's state by name; None without a gate."""
        if self._gate is None or not self._node.count_publishers("gate/state"):
            return None
        return {name: getattr(self._gate, name) for name in self._gate.get_fields_and_field_types()}

    def close(self) -> None:
        """Leave the domain."""
        self._node.context.try_shutdown()
        self._thread.join()
        self._executor.shutdown()
        self._node.destroy_node()

    def _spin(self) -> None:
        try:
            self._executor.spin()
        except ExternalShutdownException:
            return

    def _look_for_learners(self) -> None:
        """Subscribe to the progress of new learners in any namespace, and note which of them are running."""
        for topic, kinds in self._node.get_topic_names_and_types():
            if PROGRESS in kinds and topic not in self._topics:
                self._topics.add(topic)
                hear = partial(self.progress.__setitem__, topic)
                self._node.create_subscription(LearningProgress, topic, hear, LATCHED_QOS)
        running = filter(self._node.count_publishers, self.progress)
        self._learners = {f"{topic.rpartition('/')[0]}/learner" for topic in running}

    def _hear(self, message: DiagnosticArray) -> None:
        now = time.monotonic()
        ours = {each.name: (now, each) for each in message.status if OF_OURS in values_of(each)}
        if ours.keys() - self._heard.keys():
            self.heard_new_at = now
        self._heard |= ours

    def _hear_gate(self, message: GateState) -> None:
        self._gate = message


def values_of(status: DiagnosticStatus) -> dict[str, str]:
    """Return the values of a report by key."""
    return {value.key: value.value for value in status.values}


def _busy(name: str) -> DiagnosticStatus:
    return DiagnosticStatus(name=name, level=DiagnosticStatus.OK, message="busy: it updates the policy")


def _silent(status: DiagnosticStatus, seconds: float) -> DiagnosticStatus:
    message = f"silent: for {seconds:.0f} s"
    return DiagnosticStatus(name=status.name, level=DiagnosticStatus.ERROR, message=message, values=status.values)


def command(word: str, domain: int | None) -> str:
    """Call the service of an operator's command once, and return its answer; raise PeerError if it fails or refuses."""
    service, kind, request = SERVICES[word]
    node = _joined("operator", domain)
    try:
        client = node.create_client(kind, service)
        if not client.wait_for_service(FOUND_TIMEOUT_S):
            elsewhere = f"in a namespace, use ros2 service call NAMESPACE/{service}"
            raise PeerError(f"{service}: no node offers it; pass the run's folder, or set ROS_DOMAIN_ID; {elsewhere}")
        call, executor = client.call_async(request), SingleThreadedExecutor(context=node.context)
        rclpy.spin_until_future_complete(node, call, executor, ANSWER_TIMEOUT_S)
        if not call.done():
            raise PeerError(f"{service}: the node does not answer; it may have acted, see rkhs status")
        answer = call.result()
    finally:
        node.destroy_node()
        node.context.try_shutdown()
    if not answer.success:
        raise PeerError(f"{word} was refused: {answer.message}")
    return f"{word}: done" + f" ({answer.message})" * bool(answer.message)


def show(domain: int | None, *, watch: bool) -> None:
    """Print the reports once all nodes have reported, or raise PeerError; when watching, every second until Ctrl-C."""
    console = Console()
    with closing(NodeReports(domain)) as reports:
        while time.monotonic() < reports.heard_new_at + LISTEN_S and not (watch and reports.statuses):
            time.sleep(CHECK_S)
        if not reports.statuses:
            expected = f"expected running nodes, got none within {LISTEN_S:g} s"
            unknown = "pass the run's folder, or set ROS_DOMAIN_ID"
            raise PeerError(f"{expected}; {unknown if domain is None else 'the run has ended or restarts them'}")
        if not watch:
            console.print(view(reports, console))
            return
        with Live(console=console, auto_refresh=False) if console.is_terminal else nullcontext() as live:
            while True:
                known = view(reports, console)
                live.update(known, refresh=True) if live else console.print(known)
                time.sleep(REPORT_PERIOD_S)


def view(reports: NodeReports, console: Console) -> Group:
    """Return all known reports; lines do not wrap if the output is not a terminal."""
    statuses = reports.statuses
    parts: list[Text | Table] = [*map(heading, reports.progress.values()), table(statuses), *problems(statuses)]
    if not console.is_terminal:
        console.width = max(console.width, *(console.measure(part).maximum for part in parts))
    return Group(*parts)


def heading(progress: LearningProgress) -> Text:
    """Return three lines: the progress of a run, its returns, and its results folder."""
    left = "" if isnan(progress.seconds_left) else f", about {progress.seconds_left:.0f} s left"
    lines = (
        f"{truncated(progress.run)}: iteration {progress.iteration} of {progress.iterations}, "
        f"{progress.episodes} episodes, {progress.centres} centres{left}",
        f"return {progress.exploration_return:.4g}{_measured(progress)}" if progress.iteration else "no return yet",
        "in " + "".join(c if c.isprintable() else "?" for c in progress.folder),  # never truncated
    )
    return Text("\n".join(lines))


def _measured(progress: LearningProgress) -> str:
    measured = [each for each in progress.last_evaluation_returns if not isnan(each)]
    text = f", evaluation {measured[-1]:.4g}" if measured else ""
    return text + ("" if isnan(progress.model_return) else f", model {progress.model_return:.4g}")


def table(statuses: Statuses) -> Table:
    """Return the reports as a table with one row per node."""
    result = Table(box=None, pad_edge=False, collapse_padding=True)
    for head in ("node", "state", *COLUMNS.values()):
        wraps = head in ("state", "batch", "step")
        result.add_column(head, overflow="fold", no_wrap=not wraps, min_width=len(head) if wraps else None)
    for name, status in sorted(statuses.items()):
        values = values_of(status)
        state = Text(
            truncated(", ".join(dict.fromkeys(filter(None, (_word(status), values.get(MODE)))))),
            COLOURS.get(status.level, "red"),
        )
        result.add_row(Text(truncated(name)), state, *(Text(_cell(key, values.get(key, ""))) for key in COLUMNS))
    return result


def problems(statuses: Statuses) -> Iterator[Text]:
    """Yield for each node a line with its problem, lines for the sensor topics it reads, and its last refusal."""
    for name, status in sorted(statuses.items()):
        if status.message != _word(status):
            yield Text(f"{truncated(name)} {truncated(status.message)}")
        values = values_of(status)
        for key, line in values.items():
            if key.startswith(PREFIX):
                yield Text(f"{truncated(name)} {truncated(key.removeprefix(PREFIX))}: {truncated(line)}")
        if reason := values.get(LAST_REFUSAL):
            yield Text(f"{truncated(name)} last refused or ignored {truncated(reason)}")


def _word(status: DiagnosticStatus) -> str:
    """Return a node's status without its reason, which the table has no space for."""
    return str(status.message.partition(": ")[0])


def _cell(key: str, value: str) -> str:
    """Return a value for the table: the last digits of random identifiers, other values unchanged."""
    return " ".join(number[-DIGITS:] for number in truncated(value).split()) if key in RANDOM else truncated(value)
