"""Show on the page the nodes of a run over topics, and the gate of a robot."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any, Protocol

from viser import GuiApi

WORST_FIRST = ("error", "warning", "ok")
MAX_NODES = 12  # shown, worst first
MAX_LETTERS = 160  # of a node's message
STANDING = ("disarmed", "stopped")  # states of a gate that lets no command through
ARM_HINT = (
    "To arm it, make sure that the robot may move, then type `rkhs robot arm FOLDER` in a terminal beside the robot."
)
NodeReport = tuple[str, str, str]  # name, level and message of a node


class Reports(Protocol):
    """The reports of a run's nodes; see `rkhs_ros.nodes.watch.node_reports.NodeReports`."""

    def nodes(self) -> Sequence[NodeReport]:
        """Return the name, the level and the message of each node."""

    def gate(self) -> Mapping[str, Any] | None:
        """Return the fields of the gate's state by name; None without a gate."""

    def close(self) -> None:
        """Stop listening."""


OpenReports = Callable[[], Reports | None]


class NodesPanel:
    """The state of a run's nodes and of its robot's gate.

    Owns these texts, which are visible while reports arrive, and the reports while a browser shows the page.

    Args:
        gui: GUI of the page.
        open_reports: starts to listen to the nodes; returns None if there are none.
    """

    def __init__(self, gui: GuiApi, open_reports: OpenReports) -> None:
        self._open = open_reports
        self._reports: Reports | None = None
        self._nodes = gui.add_markdown("", visible=False)
        self._gate = gui.add_markdown("", visible=False)

    def refresh(self, *, running: bool) -> None:
        """Show the latest reports; listen only while the run is in progress."""
        if not running:
            self.stop_listening()
            return
        if self._reports is None:
            self._reports = self._open()
        if self._reports is not None:
            self._show(node_text(self._reports.nodes()), gate_text(self._reports.gate() or {}))

    def stop_listening(self) -> None:
        """Stop listening and hide the texts."""
        reports, self._reports = self._reports, None
        if reports is not None:
            reports.close()
        self._show("", "")

    def _show(self, nodes: str, gate: str) -> None:
        for control, text in ((self._nodes, nodes), (self._gate, gate)):
            control.visible = bool(text)
            if control.content != text:
                control.content = text


def gate_text(gate: Mapping[str, Any]) -> str:
    """Return the state of the gate as Markdown."""
    if not gate:
        return ""
    state, reason = str(gate["state"]), plain(gate["reason"])
    counts = f"{gate['commands']} commands: {gate['clamps']} limited, {gate['refusals']} refused; {gate['stops']} stops"
    hint = f"\n\n{ARM_HINT}" if state in STANDING else ""
    return f"The gate is **{plain(state)}**" + f": {reason}" * bool(reason) + f"{hint}\n\n{counts}"


def node_text(nodes: Sequence[NodeReport]) -> str:
    """Return the state of the nodes as Markdown: one line per node with a problem, worst first, then the others."""
    ranked = sorted(nodes, key=lambda node: WORST_FIRST.index(node[1]))
    faulty = [f"**{plain(name)} {level}** {plain(message)}" for name, level, message in ranked if level != "ok"]
    ok = [plain(name.strip("/")) for name, level, _ in ranked if level == "ok"]
    lines = faulty[:MAX_NODES]
    ok = ok[: MAX_NODES - len(lines)]
    return "\n\n".join([*lines, *([f"Nodes without problems: {', '.join(ok)}"] if ok else [])])


def plain(text: str) -> str:
    """Return a text with Markdown and HTML characters escaped, truncated to a bounded length."""
    some = text if len(text) <= MAX_LETTERS else f"{text[:MAX_LETTERS]} …"
    return "".join(f"\\{letter}" if letter in "\\`*_{}[]()<>#+!|~$" else letter for letter in " ".join(some.split()))
