"""The status node of ``rkhs status``: prints the progress of a run and a table of its nodes."""

import time
from collections.abc import Iterator
from contextlib import nullcontext
from functools import partial
from math import isnan

from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.executors import SingleThreadedExecutor
from rich.console import Console, Group
from rich.live import Live
from rich.table import Table
from rich.text import Text

from rkhs_interfaces.msg import LearningProgress
from rkhs_ros.base.endings import Stop
from rkhs_ros.base.validation import truncated
from rkhs_ros.nodes.core.diagnostics import REPORT_PERIOD_S
from rkhs_ros.nodes.core.messages import LATCHED_QOS
from rkhs_ros.nodes.core.publishers import PREFIX
from rkhs_ros.nodes.core.spin import SIGNAL_CHECK_S, PeerError, run
from rkhs_ros.nodes.watch.node_reports import LISTEN_S, ReportListener, Statuses, values_of

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


class StatusNode(ReportListener):
    """Subscribes to the status reports of nodes and the progress of learners.

    Owns the newest progress of each learner.
    """

    def __init__(self) -> None:
        super().__init__("status")
        self.watches = bool(self.declare_parameter("watch", False).value)
        self.progress: dict[str, LearningProgress] = {}
        self._topics: set[str] = set()

    def look_for_learners(self) -> None:
        """Subscribe to new learners in any namespace."""
        for topic, kinds in self.get_topic_names_and_types():
            if PROGRESS in kinds and topic not in self._topics:
                self._topics.add(topic)
                hear = partial(self.progress.__setitem__, topic)
                self.create_subscription(LearningProgress, topic, hear, LATCHED_QOS)


def heading(progress: LearningProgress) -> Text:
    """Return three lines: the progress of a run, its returns, and its results folder."""
    lines = (
        f"{truncated(progress.run)}: iteration {progress.iteration} of {progress.iterations}, "
        f"{progress.episodes} episodes, {progress.centres} centres{_time_left(progress)}",
        f"return {progress.exploration_return:.4g}{_measured(progress)}" if progress.iteration else "no return yet",
        "in " + "".join(c if c.isprintable() else "?" for c in progress.folder),  # never truncated
    )
    return Text("\n".join(lines))


def _time_left(progress: LearningProgress) -> str:
    return "" if isnan(progress.seconds_left) else f", about {progress.seconds_left:.0f} s left"


def _measured(progress: LearningProgress) -> str:
    """Return the last evaluation return and the model return, as text."""
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


def reasons(statuses: Statuses) -> Iterator[Text]:
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


def view(node: StatusNode, console: Console) -> Group:
    """Return all known reports; lines do not wrap if the output is not a terminal."""
    statuses = node.statuses
    parts: list[Text | Table] = [
        *(heading(each) for each in node.progress.values()),
        table(statuses),
        *reasons(statuses),
    ]
    if not console.is_terminal:
        console.width = max(console.width, *(console.measure(part).maximum for part in parts))
    return Group(*parts)


def show(node: StatusNode, stop: Stop) -> None:
    """Wait until all nodes have reported, and print the reports; when watching, print them every second until stopped.

    Raises:
        PeerError: no node reported.
    """
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    console = Console()
    _listen(node, executor, stop)
    if not (node.statuses or stop.is_set()):
        raise PeerError(
            f"expected running nodes, got none within {LISTEN_S:g} s; pass the run's folder, or set ROS_DOMAIN_ID"
        )
    if not node.watches:
        console.print(view(node, console))
        return
    with Live(console=console, auto_refresh=False) if console.is_terminal else nullcontext() as live:
        while not stop.is_set():
            known = view(node, console)
            live.update(known, refresh=True) if live else console.print(known)
            _spin(node, executor, stop, time.monotonic() + REPORT_PERIOD_S)


def _listen(node: StatusNode, executor: SingleThreadedExecutor, stop: Stop) -> None:
    """Receive reports until no new node appears; when watching, until the first node appears."""
    while time.monotonic() < node.heard_new_at + LISTEN_S and not (stop.is_set() or (node.watches and node.statuses)):
        _spin(node, executor, stop, time.monotonic() + SIGNAL_CHECK_S)


def _spin(node: StatusNode, executor: SingleThreadedExecutor, stop: Stop, until: float) -> None:
    node.look_for_learners()
    while time.monotonic() < until and not stop.is_set():
        executor.spin_once(timeout_sec=SIGNAL_CHECK_S)


def main() -> None:
    """Run the status node."""
    run(StatusNode, "status", show)


if __name__ == "__main__":
    main()
