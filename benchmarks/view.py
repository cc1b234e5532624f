"""What the page costs a run over topics: without it, only recorded, with the page and nobody there, and in a browser.

All in one run on one machine, one after the other and again, since machines are noisy: read the ratios. The browser
draws on the same cores as the run, without a graphics card.
"""

from __future__ import annotations

import argparse
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from statistics import median

os.environ["OMP_NUM_THREADS"] = "1"
ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT / "docs"))

import browser  # noqa: E402

from rkhs_ros.runs.curve import Curve  # noqa: E402

CONFIG = ROOT / "config" / "pendulum_nac.yaml"
ROUNDS, ITERATIONS = 3, 40
WARM_UP = 5  # iterations before the clock starts, in which the browser loads the page
TIMEOUT_S = 600.0
KINDS = {
    "without": ([], False),
    "recorded": (["--record"], False),
    "page, nobody there": (["--view"], False),
    "page, in a browser": (["--view"], True),
}


def seconds(options: list[str], watched: bool, iterations: int) -> float:
    """Return the seconds of a run between two of its iterations.

    Args:
        options: of ``rkhs train``.
        watched: whether a browser shows the page.
        iterations: of the run.
    """
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name) / "run"
        command = [sys.executable, "-m", "rkhs_ros.app.cli", "train", str(CONFIG), "--runner", "ros", "--quiet"]
        command += ["--iterations", str(iterations), "--out", str(folder), *options]
        quiet = {"stdin": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
        process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True, **quiet)
        try:
            with shown(process) if watched else nobody():
                rows = waited_for(folder, iterations)
        finally:
            process.send_signal(signal.SIGINT)
            process.communicate()
    return rows[-1].seconds - rows[WARM_UP - 1].seconds


@contextmanager
def nobody() -> Iterator[None]:
    """Show the page to nobody."""
    yield


@contextmanager
def shown(process: subprocess.Popen[str]) -> Iterator[None]:
    """Show the page in a browser."""
    address = next(line for line in process.stdout or [] if " at http" in line).split()[-1]
    with browser.started() as chromium:
        chromium.open(address, 1280, 800)
        yield


def waited_for(folder: Path, iterations: int) -> list:
    """Return the lines of the learning curve once they are all there.

    Raises:
        TimeoutError: they are not in time.
    """
    deadline = time.monotonic() + TIMEOUT_S
    while time.monotonic() < deadline:
        rows = Curve(folder / "curve.csv").rows() if (folder / "curve.csv").exists() else []
        if len(rows) >= iterations:
            return rows
        time.sleep(0.2)
    raise TimeoutError(f"{folder}: expected {iterations} iterations within {TIMEOUT_S:g} s")


def main(rounds: int, iterations: int) -> None:
    """Print the medians, beside those of runs without a page."""
    taken: dict[str, list[float]] = {kind: [] for kind in KINDS}
    for _ in range(rounds):
        for kind, (options, watched) in KINDS.items():
            taken[kind].append(seconds(options, watched, iterations))
    base = median(taken["without"])
    for kind, times in taken.items():
        ratio = median(one / other for one, other in zip(times, taken["without"], strict=True))
        spread = f"{min(times):.2f} to {max(times):.2f}"
        print(f"{kind:20s} {median(times):6.2f} s ({spread}), {ratio:.2f} times that without ({base:.2f} s)")


if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    parser.add_argument("--rounds", type=int, default=ROUNDS)
    parser.add_argument("--iterations", type=int, default=ITERATIONS)
    options = parser.parse_args()
    main(options.rounds, options.iterations)
