"""Serves the page of a run until it is told to end."""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import redirect_stdout, suppress
from io import StringIO
from pathlib import Path
from socket import create_server

from viser import ViserServer

from rkhs_ros.base.validation import truncated
from rkhs_ros.recordings.recording import BAG, FILE
from rkhs_ros.runs.report import is_begun
from rkhs_ros.view.bag import Bag
from rkhs_ros.view.folder import Folder
from rkhs_ros.view.guard import guard, is_local
from rkhs_ros.view.monitor import Monitor
from rkhs_ros.view.page import Page
from rkhs_ros.view.recorded import Recorded
from rkhs_ros.view.source import Source

REFRESH_S = 0.5  # between looks at the run
TICK_S = 0.05  # between looks at the controls
REST_S = 5.0  # without a browser, as while one loads the page again, after which the nodes are heard no more
BEGIN_TIMEOUT_S = 30.0  # for a run to begin
LAST_WORDS_S = 0.3  # for the browsers to take the last words


def source_of(path: Path) -> Source:
    """Return the run in a folder, in a recording, or in a bag that others recorded.

    Raises:
        ValueError: there is none.
        OSError: there is no such folder or file.
    """
    folder = path.parent if path.name == FILE and is_begun(path.parent) else path
    if (folder / BAG).is_file():
        return Bag(folder)
    if folder.is_file():
        with suppress(ValueError):  # it has no head, as what others record
            return Recorded(folder)
        return Bag(folder)
    return Recorded(folder) if (folder / FILE).is_file() else Folder(folder)


def wait_for_recording(file: Path) -> Source:
    """Wait until a run that is about to begin has begun its recording, and return it.

    Raises:
        ValueError: it does not in time.
    """
    deadline = time.monotonic() + BEGIN_TIMEOUT_S
    while time.monotonic() < deadline:
        with suppress(ValueError, OSError):
            Recorded(file)  # else it has no head yet
            return source_of(file)
        time.sleep(TICK_S)
    raise ValueError(f"{file}: expected a run to begin its recording within {BEGIN_TIMEOUT_S:g} s, got none")


def opened(host: str, port: int) -> ViserServer:
    """Return a server that takes from browsers what controls send, and nothing else.

    Args:
        host: address to listen at.
        port: port to listen at; the next free one is taken.

    Raises:
        ValueError: the address is none of this machine, for which the server would wait without end.
    """
    try:
        create_server((host, 0)).close()
    except (OSError, UnicodeError) as error:
        raise ValueError(f"host: expected an address of this machine, got {truncated(host)} ({error})") from error
    with redirect_stdout(StringIO()):  # it prints addresses, too
        server = ViserServer(host=host, port=port, verbose=False)
    guard(server, local=is_local(host))
    return server


def serve(begun: Callable[[], Source], monitor: Monitor, host: str, port: int, tell: Callable[[str], None]) -> None:
    """Serve the page of a run until an interrupt.

    Args:
        begun: returns the run, once it has begun; the page is empty until then.
        monitor: hears its nodes.
        host: address to listen at.
        port: port to listen at; the next free one is taken.
        tell: is told the address of the page as soon as it is served.

    Raises:
        ValueError: the address is none of this machine, or no run begins.
        KeyboardInterrupt: the process was told to end; the page was told of it.
    """
    server = opened(host, port)
    name = "localhost" if is_local(host) or host == "0.0.0.0" else host
    try:
        tell(f"http://{name}:{server.get_port()}")
        page = Page(server, begun(), monitor)
        try:
            page.refresh()
            page.tick()
            _work(server, page)
        finally:
            page.rest()
            page.announce_end()
            time.sleep(LAST_WORDS_S)
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
            page.rest()  # nobody looks: nothing is done any more
            watched_at = None
        time.sleep(TICK_S)
