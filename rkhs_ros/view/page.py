"""The page of a run: how far it is, its learning curve, and the iteration that is looked at."""

from __future__ import annotations

from collections.abc import Mapping
from functools import lru_cache
from typing import Any

from viser import ViserServer

from rkhs_ros.pictures.known import references
from rkhs_ros.runs.control import PAUSE, RESUME, STOP, ask
from rkhs_ros.view.curve_plot import CurvePlot
from rkhs_ros.view.iteration_panel import IterationPanel
from rkhs_ros.view.monitor import Monitor
from rkhs_ros.view.nodes_panel import NodesPanel
from rkhs_ros.view.source import PAUSED, RUNNING, Source, state_of
from rkhs_ros.view.status import status

KEPT = 12  # iterations whose policy and episodes stay in memory
PANEL_WIDTH_PX = 390
CURVE_PX, BESIDE_ROBOT_PX = 210, 150  # height of the curve, and where the panel shows a robot, too
RECENT = 6  # iterations whose episodes are drawn, that looked at included
BUTTONS = {
    RUNNING: {"Pause after this iteration": PAUSE, "Stop": STOP},
    PAUSED: {"Resume": RESUME, "Stop": STOP},
}
HINT = "Pause: it waits until it is resumed; Stop: as Ctrl-C, what was learnt is kept, and the run can go on later"


class Page:
    """The page of a run.

    Owns its controls and what they showed last. `refresh` looks at the run anew, `listen` at its nodes, `tick` at the
    controls.

    Args:
        server: that serves the page.
        source: the run.
        monitor: hears the nodes of the run.
    """

    def __init__(self, server: ViserServer, source: Source, monitor: Monitor) -> None:
        gui = self._gui = server.gui
        self._server, self._source = server, source
        self._seen = lru_cache(KEPT)(source.seen)
        self._state = ""
        gui.configure_theme(show_logo=False, show_share_button=False)
        gui.main_panel.dock_right()
        gui.main_panel.set_width(PANEL_WIDTH_PX)
        gui.set_panel_label(source.name)
        self._status = gui.add_markdown("")
        self._buttons = {state: self._offer(state, words) for state, words in BUTTONS.items()}
        self._nodes = NodesPanel(gui, monitor)
        height = BESIDE_ROBOT_PX if source.nodes else CURVE_PX
        self._curve = CurvePlot(gui, gui.add_folder("Learning curve"), references(source.task), height)
        hint = "at its right end it follows the run"
        self._iteration: Any = gui.add_slider("Iteration", 0, 1, 1, 0, disabled=True, hint=hint)
        self._showing = IterationPanel(server, source)

    def refresh(self) -> None:
        """Look at the run: at its state, its curve, and whether there is a newer iteration to follow."""
        self._source.refresh()
        state = state_of(self._source)
        if state != self._state:
            self._state = state
            self._seen.cache_clear()  # at the end there may be more of the last one
            self._showing.forget()
        for its, buttons in self._buttons.items():
            buttons.visible = its == state
        self._status.content = status(self._source, state)
        self._curve.draw(self._source.rows)
        self._follow()

    def listen(self) -> None:
        """Look at what the nodes of the run report, if it is under way."""
        self._nodes.refresh(running=self._state in (RUNNING, PAUSED))

    def rest(self) -> None:
        """Hear the nodes no more."""
        self._nodes.rest()

    def tick(self) -> None:
        """Show what the controls say, if it is not shown yet."""
        known = [number for number in self._source.iterations if number <= self._iteration.value]
        if known and not self._showing.is_of(known[-1]):
            seen = {number: each for number in known[-RECENT:] if (each := self._seen(number)) is not None}
            self._showing.show(seen)
        self._showing.move()

    def announce_end(self) -> None:
        """Say on the page that it will show nothing new any more."""
        self._status.content = "### The viewer has ended\nStart it again with `rkhs view`."
        self._server.flush()

    def _offer(self, state: str, words: Mapping[str, str]) -> Any:
        """Add the buttons of a run in some state; what they ask of it by their labels."""
        buttons = self._gui.add_button_group("Run", tuple(words), hint=HINT, visible=False)

        @buttons.on_click
        def _(event: Any) -> None:
            if state_of(self._source) == state:
                ask(self._source.path, words[event.target.value])

        return buttons

    def _follow(self) -> None:
        """Have the slider range over the iterations there are; where it is at its end it moves on with them."""
        iterations, slider = self._source.iterations, self._iteration
        if not iterations:
            return
        follows = slider.disabled or slider.value == slider.max
        if slider.max != iterations[-1]:
            slider.min, slider.max = min(iterations[0], iterations[-1] - 1), iterations[-1]
            slider.disabled = False
        if follows:
            slider.value = iterations[-1]
