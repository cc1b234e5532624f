"""``rkhs view``: show a run in the browser, while it learns or afterwards."""

from __future__ import annotations

import argparse
import sys
from importlib.util import find_spec
from pathlib import Path

import rkhs_ros.app.inline  # noqa: F401  # registers the tasks, which are shown
from rkhs_ros.base.threads import use_one_thread
from rkhs_ros.base.validation import require

HOST, PORT = "127.0.0.1", 8080
MOST_PORT = 65535
RESULTS = Path("results")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    add = parser.add_argument
    add("path", type=Path, nargs="?", metavar="DIR", help="a run's folder (the newest in results/)")
    add("--host", default=HOST, help="address to listen at; 0.0.0.0 lets other machines in (%(default)s)")
    add("--port", type=int, default=PORT, metavar="N", help="port, or the next free one (%(default)s)")


def run(options: argparse.Namespace) -> int:
    """Serve the page until Ctrl-C.

    Raises:
        ValueError: there is no such run, or viser is missing.
    """
    require(find_spec("viser") is not None, "rkhs view", "viser (pip install 'rkhs_ros[view]')", "none")
    require(0 <= options.port <= MOST_PORT, "--port", f"0 to {MOST_PORT}", options.port)
    from rkhs_ros.view.guard import is_local
    from rkhs_ros.view.serving import serve, source_of

    use_one_thread()
    source = source_of(options.path or newest_run(RESULTS))
    if not is_local(options.host):
        print(f"warning: --host {options.host}: whoever reaches it sees the run, and can stop it", file=sys.stderr)
    serve(source, options.host, options.port, lambda address: print(f"{source.path}: {address}", flush=True))
    return 0


def newest_run(results: Path) -> Path:
    """Return the folder of the run that was written to last.

    Raises:
        ValueError: there is none.
    """
    runs = {file.parent for file in results.glob("**/config.yaml")}
    require(bool(runs), f"{results}", "the folder of a run in it, or one that is named", "none")
    return max(runs, key=lambda folder: max(path.stat().st_mtime for path in folder.iterdir()))
