"""The part of the page that shows the nodes of a run over topics, and what a person may tell a robot from there."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from viser import GuiApi

from rkhs_ros.view.monitor import Monitor, NodeReport, Report

WORST_FIRST = ("error", "silent", "warning", "ok")
MOST_NODES = 12  # that are shown, the worst first
MOST_LETTERS = 160  # of what a node says
# What a person may tell the nodes from a page. To arm the gate is for somebody who stands beside the robot.
STOP = "stop"
EPISODES = {"Pause": "pause", "Start next": "start", "Veto last": "veto"}
STOP_HINT = "the gate brings it to rest, until it is armed again with rkhs robot arm"
EPISODES_HINT = (
    "Pause: none begins; Start next: the scene is in order, or the pause is over; "
    "Veto last: it counts for nothing, if nothing was learnt from it yet"
)


class NodesPanel:
    """The nodes of a run, the gate of its robot, and the buttons for that.

    Owns these controls; they are there as long as nodes are heard.

    Args:
        gui: of the page.
        monitor: hears the nodes.
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
        stop.on_click(lambda _: monitor.say(STOP))
        episodes.on_click(lambda event: monitor.say(EPISODES[event.target.value]))

    def refresh(self, *, running: bool) -> None:
        """Show what is heard; listen only to nodes of a run that is under way."""
        if running:
            self._show(self._monitor.listen())
        else:
            self.rest()

    def rest(self) -> None:
        """Listen no more."""
        self._monitor.rest()
        self._show(Report())

    def _show(self, report: Report) -> None:
        self._robot.visible, self._nodes.visible = report.gate is not None, bool(report.nodes)
        for words, text in (
            (self._gate, gate_text(report.gate or {})),
            (self._answer, plain(report.answer)),
            (self._nodes, node_text(report.nodes)),
        ):
            if words.content != text:
                words.content = text


def gate_text(gate: Mapping[str, Any]) -> str:
    """Return in Markdown how the gate fares."""
    if not gate:
        return ""
    state, reason = str(gate["state"]), plain(gate["reason"])
    counts = f"{gate['commands']} commands: {gate['clamps']} limited, {gate['refusals']} refused; {gate['stops']} stops"
    return f"The gate is **{plain(state)}**" + f": {reason}" * bool(reason) + f"\n\n{counts}"


def node_text(nodes: Sequence[NodeReport]) -> str:
    """Return in Markdown how the nodes fare: those that are not well one by one, the worst first, then the others."""
    ranked = sorted(nodes, key=lambda node: WORST_FIRST.index(node.level))
    ill = [node for node in ranked if node.level != "ok"][:MOST_NODES]
    lines = [f"**{plain(node.name)} {node.level}** {plain(node.message)}" for node in ill]
    well = [plain(node.name.strip("/")) for node in ranked if node.level == "ok"][: MOST_NODES - len(ill)]
    return "\n\n".join([*lines, *([f"Nodes well: {', '.join(well)}"] if well else [])])


def plain(text: str) -> str:
    """Return a text of others without what Markdown or a browser would take for more than words."""
    some = text if len(text) <= MOST_LETTERS else f"{text[:MOST_LETTERS]} …"
    return "".join(f"\\{letter}" if letter in "\\`*_{}[]()<>#+!|~$" else letter for letter in " ".join(some.split()))
