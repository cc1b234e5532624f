"""Measure what the page costs a run over topics, and what the monitoring topics cost without subscribers.

The speed of one run is measured in turn with the page stopped, without a browser, with a remote browser (which only
receives), and with a browser on this machine (which draws without a graphics card, on the cores of the run). The rounds
repeat, since machines are noisy: compare the ratios.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, nullcontext
from functools import partial
from itertools import cycle, islice
from pathlib import Path
from statistics import median
from threading import Thread

os.environ["OMP_NUM_THREADS"] = "1"
ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT / "docs"))

import browser  # noqa: E402
import msgspec  # noqa: E402
import rclpy  # noqa: E402
import viser  # noqa: E402
from rclpy.node import Node  # noqa: E402
from websockets.sync.client import connect  # noqa: E402

from command import parsed, parser, skip  # noqa: E402
from rkhs_ros.app.inline import runner_of  # noqa: E402
from rkhs_ros.learning.training import train  # noqa: E402
from rkhs_ros.nodes.lockstep.learning_topics import LearningTopics  # noqa: E402
from rkhs_ros.runs.config import load_config  # noqa: E402
from rkhs_ros.runs.curve import BEGINNING, Curve, Row  # noqa: E402

CONFIG = ROOT / "config" / "pendulum_nac.yaml"
ROUNDS, WINDOW_S = 6, 5.0
SETTLE_S = 6.0  # after a change: the browser loads the page, and reports of stopped nodes expire
WARM_UP = 30  # iterations before the measurement, until the policy has all centres
PUBLISH_S = 0.05  # between updates when only the topics are measured; faster than the run
MOST_ROWS = 256  # that are published
TIMEOUT_S = 120.0
STOPPED, NOBODY, AWAY, HERE = "page stopped", "no browser", "browser elsewhere", "browser on this machine"
KINDS = (STOPPED, NOBODY, AWAY, HERE)
# First messages of a browser; the page ignores it until they arrive.
CAMERA = {"type": "ViewerCameraMessage", "wxyz": [1, 0, 0, 0], "position": [0, 0, 1], "fov": 1.0, "image_height": 800,
          "image_width": 890, "near": 0.1, "far": 10.0, "look_at": [0, 0, 0], "up_direction": [0, 1, 0]}  # fmt: skip


@contextmanager
def process(*arguments: object) -> Iterator[subprocess.Popen[str]]:
    """Run a command of `rkhs` until the block ends."""
    command = [sys.executable, "-m", "rkhs_ros.app.cli", *map(str, arguments)]
    quiet = {"stdin": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    running = subprocess.Popen(command, stdout=subprocess.PIPE, text=True, **quiet)
    try:
        yield running
    finally:
        running.send_signal(signal.SIGCONT)
        running.send_signal(signal.SIGINT)
        running.communicate()


def rows_once(folder: Path, iterations: int) -> list[Row]:
    """Wait until the learning curve has a number of lines, and return them.

    Raises:
        TimeoutError: the lines do not appear in time.
    """
    deadline = time.monotonic() + TIMEOUT_S
    while time.monotonic() < deadline:
        if len(rows := Curve(folder / "curve.csv").rows()) >= iterations:
            return rows
        time.sleep(0.2)
    raise TimeoutError(f"{folder}: expected {iterations} iterations within {TIMEOUT_S:g} s")


def seconds_per_iteration(folder: Path, window_s: float) -> float:
    """Return the seconds per iteration, measured over some seconds."""
    first = rows_once(folder, 1)[-1]
    time.sleep(window_s)
    last = rows_once(folder, first.iteration + 1)[-1]
    return (last.seconds - first.seconds) / (last.iteration - first.iteration)


def cpu_seconds(pid: int) -> float:
    """Return the CPU time of a process."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return sum(map(int, fields[11:13])) / os.sysconf("SC_CLK_TCK")


@contextmanager
def taken(address: str) -> Iterator[None]:
    """Receive what the page sends to a browser."""
    url, version = address.replace("http", "ws"), f"viser-v{viser.__version__}"
    with connect(url, subprotocols=[version], max_size=None, compression=None) as socket:
        socket.send(msgspec.msgpack.encode(CAMERA))
        thread = Thread(target=lambda: [None for _ in socket])
        thread.start()
        yield
    thread.join()


@contextmanager
def drawn(chromium: browser.Browser, address: str) -> Iterator[None]:
    """Open the page in a browser."""
    tab = chromium.open(address, 1280, 800)
    yield
    tab.ask("Page.navigate", url="about:blank")
    tab.close()


def timings(rounds: int, window_s: float, settle_s: float) -> dict[str, list[tuple[float, float]]]:
    """Return for each kind and round the seconds per iteration and the share of a core that the page used."""
    found: dict[str, list[tuple[float, float]]] = {kind: [] for kind in KINDS}
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name) / "run"
        train_options = ("--runner", "ros", "--quiet", "--iterations", 100_000, "--out", folder)
        with process("train", CONFIG, *train_options):
            rows_once(folder, WARM_UP)
            with process("view", folder) as page, browser.started() as chromium:
                address = next(line for line in page.stdout or [] if " at http" in line).split()[-1]
                for kind in islice(cycle(KINDS), rounds * len(KINDS)):
                    page.send_signal(signal.SIGSTOP if kind == STOPPED else signal.SIGCONT)
                    with {AWAY: taken, HERE: partial(drawn, chromium)}.get(kind, nullcontext)(address):
                        time.sleep(settle_s)
                        began, computed = time.monotonic(), cpu_seconds(page.pid)
                        seconds = seconds_per_iteration(folder, window_s)
                        found[kind].append((seconds, (cpu_seconds(page.pid) - computed) / (time.monotonic() - began)))
    return found


def publishing(window_s: float) -> tuple[float, float]:
    """Return the share of a core used by a node with monitoring topics without subscribers, and by one without them."""
    config = load_config(CONFIG, ["iterations=5"])
    runner = runner_of(config.environment)
    iterations = list(train(config.training, runner))
    rclpy.init()
    node, parts = Node("learner"), []
    topics = LearningTopics(node, config.training)
    with tempfile.TemporaryDirectory() as name:
        topics.begin(Path(name), runner.spaces)
        for publishes in (True, False):
            parts.append(part_of_a_core(topics if publishes else None, iterations, window_s))
    rclpy.shutdown()
    return parts[0], parts[1]


def part_of_a_core(topics: LearningTopics | None, iterations: Sequence, window_s: float) -> float:
    """Return the share of a core used to publish some iterations at a fixed rate."""
    rows = [BEGINNING._replace(iteration=number, seconds=float(number)) for number in range(1, MOST_ROWS + 1)]
    end, began = time.monotonic() + window_s, time.process_time()
    for iteration in cycle(iterations):
        if time.monotonic() > end:
            break
        if topics is not None:
            topics.publish(iteration, rows)
            topics.heartbeat()
        time.sleep(PUBLISH_S)
    return (time.process_time() - began) / window_s


def main(rounds: int, window_s: float, settle_s: float) -> None:
    """Print the medians, and their ratios to those with the page stopped."""
    busy, idle = publishing(window_s)
    print(f"monitoring topics without subscribers: {busy:.2%} of a core; the same node without them: {idle:.2%}")
    found = timings(rounds, window_s, settle_s)
    base = [seconds for seconds, _ in found[STOPPED]]
    for kind, measured in found.items():
        times, parts = zip(*measured, strict=True)
        ratio = median(one / other for one, other in zip(times, base, strict=True))
        spread = f"{1e3 * median(times):.1f} ms an iteration ({1e3 * min(times):.0f} to {1e3 * max(times):.0f})"
        print(f"{kind:24s} {spread}, {ratio:.2f} times that without the page; it uses {median(parts):.0%} of a core")


if __name__ == "__main__":
    if browser.found() is None:
        skip("chromium", "apt-get install chromium")
    command = parser(__doc__)
    command.add_argument("--rounds", type=int, default=ROUNDS)
    command.add_argument("--window", type=float, default=WINDOW_S, help="seconds of a measurement")
    command.add_argument("--settle", type=float, default=SETTLE_S, help="seconds between two measurements")
    options = parsed(command, rounds=1, window=0.5, settle=0.5)
    main(options.rounds, options.window, options.settle)
