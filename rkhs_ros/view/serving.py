"""Serve the page of a run until an interrupt, or write it as a self-contained HTML page."""

import time
from base64 import b64encode
from collections.abc import Callable, Mapping
from contextlib import redirect_stdout, suppress
from html import escape
from io import BytesIO, StringIO
from pathlib import Path
from socket import create_server

from viser import ViserServer

from rkhs_ros.base.validation import require, truncated
from rkhs_ros.pictures.run_pictures import curve_figure
from rkhs_ros.runs.curve import columns
from rkhs_ros.view.iteration_panel import IterationPanel
from rkhs_ros.view.page import OpenReports, Page, status
from rkhs_ros.view.recorded import Recorded, state_of

LOCAL = ("127.0.0.1", "0.0.0.0", "localhost")
REFRESH_S = 0.5  # between reads of the run
TICK_S = 0.05  # between reads of the controls
REST_S = 5.0  # without a browser until the nodes' reports stop; longer than a browser needs to reload the page
BEGIN_TIMEOUT_S = 30.0  # for a run to start
END_MESSAGE_S = 0.3  # for the browsers to receive the last message
CURVE_DPI = 110
STYLE = """
body { font-family: sans-serif; max-width: 1100px; margin: 2em auto; padding: 0 1em; overflow-wrap: anywhere; }
img { max-width: 100%; }
iframe { width: 100%; height: 620px; border: 1px solid #ccc; }
"""


def wait_for_recording(file: Path) -> Recorded:
    """Wait for a starting run to begin its recording, and open it."""
    deadline = time.monotonic() + BEGIN_TIMEOUT_S
    while time.monotonic() < deadline:
        with suppress(ValueError, OSError):
            return Recorded(file)  # raises until the file has a header
        time.sleep(TICK_S)
    raise ValueError(f"{file}: expected a recording to begin within {BEGIN_TIMEOUT_S:g} s, got none")


def opened(host: str, port: int) -> ViserServer:
    """Start a server at an address of this machine, else it would wait forever, on a port or the next free one."""
    require(bool(host), "host", "an address of this machine", "none")  # which would stand for all
    try:
        create_server((host, 0)).close()
    except (OSError, UnicodeError) as error:
        raise ValueError(f"host: expected an address of this machine, got {truncated(host)} ({error})") from error
    with redirect_stdout(StringIO()):  # viser prints addresses, too
        return ViserServer(host=host, port=port, verbose=False)


def serve(
    begun: Callable[[], Recorded],
    others: Mapping[str, Recorded],
    open_reports: OpenReports,
    host: str,
    port: int,
    on_address: Callable[[str], None],
) -> None:
    """Serve the page of a run until an interrupt."""
    server = opened(host, port)
    name = "localhost" if host in LOCAL else host
    try:
        on_address(f"http://{name}:{server.get_port()}")
        page = Page(server, begun(), open_reports, others)
        try:
            page.refresh()
            page.tick()
            _work(server, page)
        finally:
            page.nodes.stop_listening()
            page.announce_end()
            time.sleep(END_MESSAGE_S)
    finally:
        with redirect_stdout(StringIO()):
            server.stop()


def _work(server: ViserServer, page: Page) -> None:
    due = 0.0
    watched_at: float | None = None
    while True:
        now = time.monotonic()
        if server.get_clients():
            watched_at = now
            if now >= due:
                page.refresh()
                page.listen()
                due = now + REFRESH_S
            page.tick()
        elif watched_at is not None and now - watched_at > REST_S:
            page.nodes.stop_listening()  # without a browser the page is idle
            watched_at = None
        time.sleep(TICK_S)


def html_page(source: Recorded) -> str:
    """Return the page of a run with at least one iteration, which needs no other file and no connection."""
    source.refresh()
    require(bool(source.rows), f"{source.path}", "a run with at least one complete iteration", "none")
    name, curve = escape(source.name), BytesIO()
    curve_figure(columns(source.rows), source.task).savefig(curve, format="png", dpi=CURVE_DPI, facecolor="white")
    lines = status(source, state_of(source)).translate(str.maketrans("", "", "#*`")).split("\n\n")
    return f"""<!DOCTYPE html>
<html lang="en"><head><meta charset="utf-8"><title>{name}</title><style>{STYLE}</style></head><body>
<h1>{name}</h1>
{"".join(f"<p>{escape(line)}</p>" for line in lines)}
<h2>Learning curve</h2>
<img alt="Returns per iteration" src="data:image/png;base64,{b64encode(curve.getvalue()).decode()}">
<h2>An episode of iteration {source.iterations[-1]}</h2>
<p>Drag the bar below the scene to any moment. Drag the scene to turn it.</p>
<iframe title="An episode in 3D, and the policy" srcdoc="{escape(_scene(source))}"></iframe>
</body></html>
"""


def _scene(source: Recorded) -> str:
    server = opened(LOCAL[0], 8080)
    try:
        recording = server.get_scene_serializer()
        panel = IterationPanel(server, source)
        last = source.iterations[-1]
        if (view := source.load(last)) is None:
            raise ValueError(f"{source.path}: expected the episodes of iteration {last}, got none")
        panel.show({last: view})
        panel.play_once(recording.insert_sleep)
        return recording.as_html()
    finally:
        with redirect_stdout(StringIO()):  # viser prints that it stops
            server.stop()
