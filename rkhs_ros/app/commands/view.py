"""``rkhs view``: show a run in the browser, live or afterwards."""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from rkhs_ros.app.inline import add_environment_argument
from rkhs_ros.app.launcher import domain_of
from rkhs_ros.base.endings import INTERRUPTED
from rkhs_ros.base.processes import python, terminate_with_parent
from rkhs_ros.base.validation import missing_ros, require, require_extra
from rkhs_ros.recordings.recording import FILE

if TYPE_CHECKING:
    from rkhs_ros.nodes.watch import NodeReports

HOST, PORT = "127.0.0.1", 8080
MOST_PORT = 65535
RESULTS = Path("results")
NICENESS = 5  # of the page process, so that the run has priority


def add_view(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of ``rkhs view``."""
    add = parser.add_argument
    about = "a run's folder, or a recording (default: newest run in results/)"
    add("path", type=Path, nargs="?", metavar="DIR|FILE", help=about)
    add("others", type=Path, nargs="*", metavar="OTHER", help="other runs, to compare their evaluation returns")
    add("--wait", action="store_true", help="wait for a run that is about to start its recording")
    add("--host", default=HOST, help="address to listen on; 0.0.0.0 admits other machines (default: %(default)s)")
    about = "port; the next free port is used if taken (default: %(default)s)"
    add("--port", type=int, default=PORT, metavar="N", help=about)
    add_environment_argument(parser)


def run_view(options: argparse.Namespace) -> int:
    """Serve the page until Ctrl-C."""
    require_extra("viser", "view", "view")
    require(0 <= options.port <= MOST_PORT, "--port", f"0 to {MOST_PORT}", options.port)
    from rkhs_ros.view.recorded import Recorded
    from rkhs_ros.view.serving import serve, wait_for_recording

    os.nice(NICENESS)
    path = options.path or _newest_run(RESULTS)
    source = None if options.wait else Recorded(path)
    folder = source.path if source else path.parent if path.suffix == ".mcap" else path
    others = {str(other): Recorded(other) for other in options.others}
    print_address = partial(print, f"View {folder} at", flush=True)
    try:
        begun = (lambda: source) if source else partial(wait_for_recording, path)
        serve(begun, others, reports_of(folder), options.host, options.port, print_address)
    except KeyboardInterrupt:  # the normal way to stop
        return INTERRUPTED
    return 0


def reports_of(folder: Path) -> Callable[[], NodeReports | None]:
    """Return a function that starts to listen to the nodes of a run, or returns None if none is active."""
    if missing_ros():
        return lambda: None
    from rkhs_ros.nodes.watch import NodeReports

    def reports() -> NodeReports | None:
        with suppress(ValueError, OSError):
            return NodeReports(domain_of(folder))
        return None

    return reports


@contextmanager
def page_beside(folder: Path) -> Iterator[subprocess.Popen[str]]:
    """Serve the page of a run in a separate process, whose failure does not affect the run.

    Print the address of the page before the run starts.
    """
    command = [*python("rkhs_ros.app.cli"), "view", "--wait", str(folder / FILE)]
    page = subprocess.Popen(
        command,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        text=True,
        process_group=0,
        preexec_fn=partial(terminate_with_parent, os.getpid()),
    )
    end = page.kill  # no browser is connected while the process starts
    try:
        if page.stdout and (address := page.stdout.readline()):
            print(address, end="", flush=True)
            end = page.terminate
        yield page
    finally:
        end()
        page.wait()


def stay_with(page: subprocess.Popen[str]) -> None:
    """Wait until the process of the page ends, or for Ctrl-C."""
    if page.poll() is None:
        with suppress(KeyboardInterrupt):
            print("The page stays open until Ctrl-C.", file=sys.stderr, flush=True)
            page.wait()


def _newest_run(results: Path) -> Path:
    runs = {file.parent for file in results.glob("**/config.yaml")}
    require(bool(runs), f"{results}", "at least one run, or the argument DIR", "none")
    return max(runs, key=lambda folder: max(path.stat().st_mtime for path in folder.iterdir()))
