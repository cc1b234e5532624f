"""The page of a run: its progress, its nodes, its learning curve and the selected iteration."""

from collections.abc import Callable, Mapping, Sequence
from functools import lru_cache
from math import isnan, nan
from typing import Any

from viser import GuiApi, ViserServer

from rkhs_ros.pictures.run_pictures import curve_figure
from rkhs_ros.pictures.style import pixels
from rkhs_ros.runs.curve import columns, seconds_left
from rkhs_ros.runs.report import advice_in
from rkhs_ros.view.iteration_panel import IterationPanel
from rkhs_ros.view.recorded import RUNNING, Recorded, state_of

MAX_CACHED = 12  # iterations in memory
PANEL_WIDTH_PX = 390
CURVE_IN, CURVE_DPI = (5.6, 4.0), 140  # size of the curve, and its resolution on sharp screens
RECENT = 6  # iterations whose episodes are drawn, including the selected one
# Below this width, viser puts a narrow panel over the lower part of the scene: widen it, and end the scene above it.
ON_PHONE = """<style>@media (max-width: 36em) {
  [style*="width: 20em"] { width: 100% !important; }
  [style*="inset"]:has(> canvas) { bottom: 60% !important; }
}</style>"""
WORST_FIRST = ("error", "warning", "ok")
MAX_NODES = 12  # shown, worst first
MAX_LETTERS = 160  # of a node's message
STANDING = ("disarmed", "stopped")  # states of a gate that lets no command through
ARM_HINT = (
    "To arm it, make sure that the robot may move, then type `rkhs robot arm FOLDER` in a terminal beside the robot."
)
NodeReport = tuple[str, str, str]  # name, level and message of a node
OpenReports = Callable[[], Any]  # starts to listen; returns `rkhs_ros.nodes.watch.NodeReports`, or None without nodes


class NodesPanel:
    """The state of a run's nodes and of its robot's gate.

    Owns this text, which is visible while reports arrive, and the reports while a browser shows the page.
    """

    def __init__(self, gui: GuiApi, open_reports: OpenReports) -> None:
        self._open = open_reports
        self._reports: Any = None
        self._text = gui.add_markdown("", visible=False)

    def refresh(self, *, running: bool) -> None:
        """Show the latest reports; listen only while the run is in progress."""
        if not running:
            self.stop_listening()
            return
        if self._reports is None:
            self._reports = self._open()
        if self._reports is not None:
            self._show(node_text(self._reports.nodes()) + gate_text(self._reports.gate() or {}))

    def stop_listening(self) -> None:
        """Stop listening and hide the text."""
        if self._reports is not None:
            self._reports.close()
        self._reports = None
        self._show([])

    def _show(self, paragraphs: list[str]) -> None:
        self._text.visible = bool(paragraphs)
        self._text.content = "\n\n".join(paragraphs)


def gate_text(gate: Mapping[str, Any]) -> list[str]:
    """Return the state of the gate as paragraphs of Markdown."""
    if not gate:
        return []
    state, reason = str(gate["state"]), plain(gate["reason"])
    counts = f"{gate['commands']} commands: {gate['clamps']} limited, {gate['refusals']} refused; {gate['stops']} stops"
    return [f"The gate is **{plain(state)}**" + f": {reason}" * bool(reason), *[ARM_HINT] * (state in STANDING), counts]


def node_text(nodes: Sequence[NodeReport]) -> list[str]:
    """Return the state of the nodes as paragraphs: one per node with a problem, worst first, then the others."""
    ranked = sorted(nodes, key=lambda node: WORST_FIRST.index(node[1]))
    faulty = [f"**{plain(name)} {level}** {plain(message)}" for name, level, message in ranked if level != "ok"]
    ok = [plain(name.strip("/")) for name, level, _ in ranked if level == "ok"]
    lines = faulty[:MAX_NODES]
    ok = ok[: MAX_NODES - len(lines)]
    return [*lines, *([f"Nodes without problems: {', '.join(ok)}"] if ok else [])]


def plain(text: str) -> str:
    """Return a text with Markdown and HTML characters escaped, truncated to a bounded length."""
    some = text if len(text) <= MAX_LETTERS else f"{text[:MAX_LETTERS]} …"
    return "".join(f"\\{letter}" if letter in "\\`*_{}[]()<>#+!|~$" else letter for letter in " ".join(some.split()))


class Page:
    """The page of a run.

    Owns its controls and their last state. `refresh` reads the run, `listen` the reports of its nodes, and `tick` the
    controls. ``open_reports`` starts to listen to the run's nodes; it returns None if there are none. The evaluation
    returns of the other runs are drawn, by name, beside those of the run.
    """

    def __init__(
        self, server: ViserServer, source: Recorded, open_reports: OpenReports, others: Mapping[str, Recorded]
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
        self.nodes = NodesPanel(gui, open_reports)
        self._curve: Any = None
        self._curve_folder = gui.add_folder("Learning curve")
        self._drawn: list[int] = []
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
        self._draw_curve()
        self._follow()

    def listen(self) -> None:
        """Show the reports of the nodes, if the run is in progress."""
        self.nodes.refresh(running=self._state == RUNNING)

    def tick(self) -> None:
        """Show what the controls select, if the page does not show it yet."""
        known = [number for number in self._source.iterations if number <= self._iteration.value]
        if known and not self._showing.is_showing(known[-1]):
            iterations = {number: each for number in known[-RECENT:] if (each := self._load(number)) is not None}
            self._showing.show(iterations)
        self._showing.move()

    def announce_end(self) -> None:
        """Show that the viewer has ended."""
        self._status.content = "### The viewer has ended\nRestart it with `rkhs view`."
        self._server.flush()

    def _draw_curve(self) -> None:
        """Draw the learning curve, and the evaluation returns of other runs, if a curve changed."""
        lengths = [len(each.rows) for each in (self._source, *self._others.values())]
        if lengths == self._drawn or not self._source.rows:
            return
        self._drawn = lengths
        others = {name: columns(other.rows) for name, other in self._others.items()}
        figure = curve_figure(columns(self._source.rows), self._source.task, others, CURVE_IN)
        figure.set_dpi(CURVE_DPI)
        if self._curve is None:
            with self._curve_folder:
                self._curve = self._gui.add_image(pixels(figure), format="png")
        else:
            self._curve.image = pixels(figure)

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


def status(source: Recorded, state: str) -> str:
    """Return the progress of a run as Markdown."""
    rows = source.rows
    lines = [f"### {state.capitalize()}: iteration {rows[-1].iteration if rows else 0} of {source.total}"]
    if rows:
        last = rows[-1]
        counts = {"episode": last.episodes, "step": last.steps, "centre": last.centres}
        sizes = ", ".join(f"{count} {what}{'s' * (count != 1)}" for what, count in counts.items() if count)
        seconds = seconds_left(rows, source.total) if state == RUNNING else nan
        lines.append(f"{sizes}, {clock(last.seconds)}" + ("" if isnan(seconds) else f", about {clock(seconds)} left"))
        evaluated = (row.evaluation_return for row in reversed(rows) if not isnan(row.evaluation_return))
        evaluation = next(evaluated, nan)
        returns = ("exploration", last.exploration_return), ("evaluation", evaluation), ("model", last.model_return)
        known = [f"{kind} **{value:.4g}**" for kind, value in returns if not isnan(value)]
        lines.append(f"Return: {', '.join(known)}")
    lines += [f"**Note**: {advice}" for advice in advice_in(source.path)]
    return "\n\n".join([*lines, f"`{source.task.environment}` in `{source.path}`"])


def clock(seconds: float) -> str:
    """Return a duration in rounded units, such as "5 h 33 min"."""
    if seconds < 100:
        return f"{seconds:.0f} s"
    minutes = round(seconds / 60)
    return f"{minutes} min" if minutes < 100 else f"{minutes // 60} h {minutes % 60} min"
