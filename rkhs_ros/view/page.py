"""The page of a run: its progress, its nodes, its learning curve and the selected iteration."""

from collections.abc import Callable, Mapping, Sequence
from functools import lru_cache
from typing import Any, Protocol

from viser import GuiApi, ViserServer

from rkhs_ros.pictures.known import references
from rkhs_ros.view.curve_plot import CurvePlot
from rkhs_ros.view.iteration_panel import IterationPanel
from rkhs_ros.view.recorded import RUNNING, Recorded, state_of
from rkhs_ros.view.status import status

MAX_CACHED = 12  # iterations in memory
PANEL_WIDTH_PX = 390
CURVE_PX, BESIDE_ROBOT_PX = 210, 150  # height of the curve, without and with a robot in the panel
RECENT = 6  # iterations whose episodes are drawn, including the selected one
# Below this width, viser puts a narrow panel over the lower part of the scene: widen it, and end the scene above it.
ON_PHONE = """<style>@media (max-width: 36em) {
  [style*="width: 20em"] { width: 100% !important; }
  [style*="inset"]:has(> canvas) { bottom: 60% !important; }
}</style>"""
NO_OTHERS: Mapping[str, Recorded] = {}
WORST_FIRST = ("error", "warning", "ok")
MAX_NODES = 12  # shown, worst first
MAX_LETTERS = 160  # of a node's message
STANDING = ("disarmed", "stopped")  # states of a gate that lets no command through
ARM_HINT = (
    "To arm it, make sure that the robot may move, then type `rkhs robot arm FOLDER` in a terminal beside the robot."
)
NodeReport = tuple[str, str, str]  # name, level and message of a node


class Reports(Protocol):
    """The reports of a run's nodes; see `rkhs_ros.nodes.watch.NodeReports`."""

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


class Page:
    """The page of a run.

    Owns its controls and their last state. `refresh` reads the run, `listen` the reports of its nodes, and `tick` the
    controls.

    Args:
        server: server of the page.
        source: run to show.
        open_reports: starts to listen to the run's nodes; returns None if there are none.
        others: other runs by name, whose evaluation returns are drawn beside those of the run.
    """

    def __init__(
        self,
        server: ViserServer,
        source: Recorded,
        open_reports: OpenReports,
        others: Mapping[str, Recorded] = NO_OTHERS,
    ) -> None:
        gui = self._gui = server.gui
        self._server, self._source, self._others = server, source, others
        self._load = lru_cache(MAX_CACHED)(source.load)
        self._state = ""
        gui.configure_theme(show_logo=False, show_share_button=False)
        gui.main_panel.dock_right()
        gui.main_panel.set_width(PANEL_WIDTH_PX)
        gui.set_panel_label(source.name)
        gui.add_html(ON_PHONE)
        self._status = gui.add_markdown("")
        self._nodes = NodesPanel(gui, open_reports)
        height = BESIDE_ROBOT_PX if source.nodes else CURVE_PX
        self._curve = CurvePlot(gui, gui.add_folder("Learning curve"), references(source.task), height)
        hint = "From the first to the last stored iteration. At its right end the slider follows the run."
        self._iteration: Any = gui.add_slider("Iteration", 0, 1, 1, 0, disabled=True, hint=hint)
        self._showing = IterationPanel(server, source)

    def refresh(self) -> None:
        """Read the run's state and curve, and follow its newest iteration."""
        self._source.refresh()
        state = state_of(self._source)
        if state != self._state:
            self._state = state
            self._load.cache_clear()  # the end of a run adds evaluation episodes to its last iteration
            self._showing.reset()
        self._status.content = status(self._source, state)
        for other in self._others.values():
            other.refresh()
        self._curve.draw(self._source.rows, {name: other.rows for name, other in self._others.items()})
        self._follow()

    def listen(self) -> None:
        """Show the reports of the nodes, if the run is in progress."""
        self._nodes.refresh(running=self._state == RUNNING)

    def stop_listening(self) -> None:
        """Stop receiving the reports of the nodes."""
        self._nodes.stop_listening()

    def tick(self) -> None:
        """Show what the controls select, if the page does not show it yet."""
        known = [number for number in self._source.iterations if number <= self._iteration.value]
        if known and not self._showing.is_showing(known[-1]):
            iterations = {number: each for number in known[-RECENT:] if (each := self._load(number)) is not None}
            self._showing.show(iterations)
        self._showing.move()

    def announce_end(self) -> None:
        """Show on the page that the viewer has ended."""
        self._status.content = "### The viewer has ended\nRestart it with `rkhs view`."
        self._server.flush()

    def _follow(self) -> None:
        """Update the range of the slider; if it is at its right end, move it to the newest iteration."""
        iterations, slider = self._source.iterations, self._iteration
        if not iterations:
            return
        follows = slider.disabled or slider.value == slider.max
        if slider.max != iterations[-1]:
            slider.min, slider.max = min(iterations[0], iterations[-1] - 1), iterations[-1]
            slider.disabled = False
        if follows:
            slider.value = iterations[-1]
