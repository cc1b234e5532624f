"""Serves the page of a run until it is told to end."""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import redirect_stdout
from io import StringIO
from pathlib import Path

from viser import ViserServer

from rkhs_ros.view.folder import Folder
from rkhs_ros.view.guard import guard, is_local
from rkhs_ros.view.page import Page
from rkhs_ros.view.source import Source

REFRESH_S = 0.5  # between looks at the run
TICK_S = 0.05  # between looks at the controls
LAST_WORDS_S = 0.3  # for the browsers to take the last words


def source_of(path: Path) -> Source:
    """Return the run in a folder.

    Raises:
        ValueError: there is none.
    """
    return Folder(path)


def serve(source: Source, host: str, port: int, tell: Callable[[str], None]) -> None:
    """Serve the page of a run until an interrupt.

    Args:
        source: the run.
        host: address to listen at.
        port: port to listen at; the next free one is taken.
        tell: is told the address of the page.

    Raises:
        KeyboardInterrupt: the process was told to end; the page was told of it.
    """
    with redirect_stdout(StringIO()):  # it prints addresses, too
        server = ViserServer(host=host, port=port, verbose=False)
    guard(server, local=is_local(host))
    page = Page(server, source)
    page.refresh()
    shown = "localhost" if is_local(host) or host == "0.0.0.0" else host
    tell(f"http://{shown}:{server.get_port()}")
    try:
        _work(server, page)
    finally:
        page.tell_end()
        time.sleep(LAST_WORDS_S)


def _work(server: ViserServer, page: Page) -> None:
    due = 0.0
    while True:
        if server.get_clients() or not due:  # nobody looks: nothing is done
            if time.monotonic() >= due:
                page.refresh()
                due = time.monotonic() + REFRESH_S
            page.tick()
        time.sleep(TICK_S)
