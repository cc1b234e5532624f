"""Show the nodes of a run over topics on the page, and offer the commands that are safe to send from there."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from viser import GuiApi

from rkhs_ros.view.monitor import Monitor, NodeReport, Report

WORST_FIRST = ("error", "silent", "warning", "ok")
MAX_NODES = 12  # shown, worst first
MAX_LETTERS = 160  # of a node's message
# The commands of the page. Arming is not among them: it requires a person beside the robot.
STOP = "stop"
EPISODES = {"Pause": "pause", "Start next": "start", "Veto last": "veto"}
STANDING = ("disarmed", "stopped")  # states of a gate that lets no command through
ARM_HINT = "To arm it, make sure that the robot may move, then type `rkhs robot arm` in a terminal beside the robot."
STOP_HINT = "The gate stops the robot until someone arms it again with rkhs robot arm."
EPISODES_HINT = (
    "Pause: start no further episode. Start next: confirm that the scene is ready, or end the pause. "
    "Veto last: discard the last episode, unless an update has used it already."
)


class NodesPanel:
    """The state of a run's nodes and of its robot's gate, with buttons for the robot.

    Owns these controls. They are visible while reports arrive.

    Args:
        gui: GUI of the page.
        monitor: receives the reports of the nodes.
    """

    def __init__(self, gui: GuiApi, monitor: Monitor) -> None:
        self._monitor = monitor
        self._nodes = gui.add_markdown("", visible=False)
        self._robot = gui.add_folder("Robot", visible=False)
        with self._robot:
            self._gate = gui.add_markdown("")
            stop = gui.add_button("Stop the robot", hint=STOP_HINT, color="red")
            episodes = gui.add_button_group("Episodes", tuple(EPISODES), hint=EPISODES_HINT)
            self._answer = gui.add_markdown("")
        stop.on_click(lambda _: monitor.send(STOP))
        episodes.on_click(lambda event: monitor.send(EPISODES[event.target.value]))

    def refresh(self, *, running: bool) -> None:
        """Show the latest report; listen only while the run is in progress."""
        if running:
            self._show(self._monitor.listen())
        else:
            self.stop_listening()

    def stop_listening(self) -> None:
        """Stop listening and hide the controls."""
        self._monitor.stop_listening()
        self._show(Report())

    def _show(self, report: Report) -> None:
        self._robot.visible, self._nodes.visible = report.gate is not None, bool(report.nodes)
        for control, text in (
            (self._gate, gate_text(report.gate or {})),
            (self._answer, plain(report.answer)),
            (self._nodes, node_text(report.nodes)),
        ):
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
    ranked = sorted(nodes, key=lambda node: WORST_FIRST.index(node.level))
    faulty = [node for node in ranked if node.level != "ok"][:MAX_NODES]
    lines = [f"**{plain(node.name)} {node.level}** {plain(node.message)}" for node in faulty]
    ok = [plain(node.name.strip("/")) for node in ranked if node.level == "ok"][: MAX_NODES - len(faulty)]
    return "\n\n".join([*lines, *([f"Nodes without problems: {', '.join(ok)}"] if ok else [])])


def plain(text: str) -> str:
    """Return a text with Markdown and HTML characters escaped, truncated to a bounded length."""
    some = text if len(text) <= MAX_LETTERS else f"{text[:MAX_LETTERS]} …"
    return "".join(f"\\{letter}" if letter in "\\`*_{}[]()<>#+!|~$" else letter for letter in " ".join(some.split()))
