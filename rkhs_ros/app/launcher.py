"""Starts the nodes of a run in processes of their own, starts again those that die, and ends them together."""

from __future__ import annotations

import ctypes
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from copy import deepcopy
from pathlib import Path
from types import FrameType

import yaml

from rkhs_ros.nodes.names import node_names
from rkhs_ros.nodes.transport import by_udp

FAILED = 1  # exit code
PATIENCE = 5.0  # seconds that a node has to end after a signal
LOOK = 0.05  # seconds between looks at the nodes
MOST_DEATHS, WITHIN = 10, 300.0  # of a node, in seconds, after which the run is given up
LEAST_DELAY, MOST_DELAY = 0.05, 5.0  # seconds before a node is started again, twice as many each time
MODULES = {
    "simulator": "sim_nodes.simulator_node",
    "policy": "rkhs_ros.nodes.policy_node",
    "learner": "rkhs_ros.nodes.learner_node",
    "status": "rkhs_ros.nodes.status_node",
}
_libc = ctypes.CDLL(None)
_END_WITH_PARENT = 1  # PR_SET_PDEATHSIG of prctl(2)


class NodeProcess:
    """A node in a process of its own, which can be started again.

    Owns the process and the times of its deaths.

    Args:
        name: a key of `MODULES`, after a namespace and a slash if need be.
        arguments: of the node, after ``--ros-args``.
    """

    def __init__(self, name: str, arguments: Sequence[str] = ()) -> None:
        self.name = name
        self._arguments = list(arguments)
        self._deaths: list[float] = []
        self._due: float | None = None  # when it is to be started again
        self.told = False  # to end
        self.process = self._start()

    def ended(self) -> int | None:
        """Return the exit code if the node ended; start it again when it is time to, if it died."""
        if self._due is None:
            return self.process.poll()
        if time.monotonic() >= self._due:
            self._due = None
            self.process = self._start()
        return None

    def interrupt(self) -> None:
        """Have the node end."""
        self.told = True
        self.process.send_signal(signal.SIGINT)

    def revive(self) -> bool:
        """Have a node that was killed started again; return False where it died too often."""
        now = time.monotonic()
        self._deaths.append(now)
        recent = sum(now - death < WITHIN for death in self._deaths)
        if recent > MOST_DEATHS:
            return False
        delay = min(LEAST_DELAY * 2 ** (recent - 1), MOST_DELAY)
        print(
            f"warning: the {self.name} node was killed by signal {-self.process.returncode}; "
            f"starting it again in {delay:g} s ({recent} of {MOST_DEATHS} times within {WITHIN:g} s)",
            file=sys.stderr,
        )
        self._due = now + delay
        return True

    def _start(self) -> subprocess.Popen[bytes]:
        """Start the node outside our foreground group, so that a Ctrl-C reaches it once, through us."""
        namespace, _, kind = self.name.rpartition("/")
        again = [f"restarts:={len(self._deaths)}"] if self._deaths else []
        if again and kind == "learner":
            again.append("resume:=true")
        words = [word for assignment in again for word in ("-p", assignment)]
        return subprocess.Popen(
            [sys.executable, "-m", MODULES[kind], "--ros-args", "-r", f"__ns:=/{namespace}", *self._arguments, *words],
            stdin=subprocess.DEVNULL,
            process_group=0,
            env=_environment(),
            preexec_fn=_end_with_parent,
        )


Nodes = dict[str, NodeProcess]


def launch(parameters: str, learner_parameters: Sequence[str] = (), *, simulators: int = 1) -> int:
    """Run the nodes until the learner ends.

    Args:
        parameters: content of a ROS parameter file.
        learner_parameters: further ``name:=value`` for the learner.
        simulators: number of simulator nodes, of more than one each in a namespace of its own.

    Returns:
        The learner's exit code, or that of a node that ended before it.
    """
    names = node_names(simulators)
    with tempfile.TemporaryDirectory(prefix="rkhs_") as folder:
        file = Path(folder) / "parameters.yaml"
        file.write_text(for_all(parameters, simulators))
        with started(names, file, learner_parameters) as nodes, _signals_passed_to(nodes["learner"]):
            return _watch(nodes)


def for_all(parameters: str, simulators: int) -> str:
    """Return the parameter file with the simulator's under the name of each one, and what the policy node needs."""
    document = yaml.safe_load(parameters)
    simulator = document.pop("simulator")
    # Copies, since ROS reads no YAML with aliases.
    document |= {f"/{name}": deepcopy(simulator) for name in node_names(simulators) if name.endswith("simulator")}
    document["policy"] = {"ros__parameters": {"simulators": simulators}}
    return str(yaml.safe_dump(document))


@contextmanager
def started(names: Iterable[str], parameters: Path, learner_parameters: Sequence[str] = ()) -> Iterator[Nodes]:
    """Start nodes, and end those that still run at the exit of the context.

    Args:
        names: keys of `MODULES`, after a namespace and a slash if need be.
        parameters: a ROS parameter file.
        learner_parameters: further ``name:=value`` for the learner.
    """
    extra = [word for assignment in learner_parameters for word in ("-p", assignment)]
    nodes: Nodes = {}
    try:
        for name in names:
            nodes[name] = NodeProcess(name, ["--params-file", str(parameters), *(extra if name == "learner" else [])])
        yield nodes
    finally:
        _end([node.process for node in nodes.values()])


def _environment() -> dict[str, str]:
    # The wheels of ROS 2 start Python once more to set the library path, unless this says that they did.
    return by_udp({k: v for k, v in os.environ.items() if k != "_ROS_WHEELS_BOOTSTRAP_COMPLETE"})


def _end_with_parent() -> None:
    """Have the kernel end this process when the launcher dies, however it does."""
    _libc.prctl(_END_WITH_PARENT, signal.SIGTERM)


def _watch(nodes: Nodes) -> int:
    while True:
        for node in nodes.values():
            code = node.ended()
            if code is None:
                continue
            if code < 0 and not node.told:
                if not node.revive():
                    return _report_loss(node.name, f"was killed more than {MOST_DEATHS} times within {WITHIN:g} s")
            elif code != 0 or node.name == "learner":
                return abs(code)
            else:
                return _report_loss(node.name, "ended before the learner")
        time.sleep(LOOK)


def _report_loss(name: str, how: str) -> int:
    print(f"error: the {name} node {how}", file=sys.stderr)
    return FAILED


@contextmanager
def _signals_passed_to(learner: NodeProcess) -> Iterator[None]:
    """Let the first signal end the learner, which writes what was learnt; a second one ends us."""

    def pass_on(number: int, frame: FrameType | None) -> None:
        for each in previous:
            signal.signal(each, signal.default_int_handler)
        if learner.process.poll() is not None:
            raise KeyboardInterrupt
        learner.interrupt()

    previous = {number: signal.signal(number, pass_on) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield
    finally:
        for number, handler in previous.items():
            signal.signal(number, handler)


def _end(processes: Iterable[subprocess.Popen[bytes]]) -> None:
    processes = list(processes)
    for process in processes:
        process.terminate()
    deadline = time.monotonic() + PATIENCE
    for process in processes:
        try:
            process.wait(max(deadline - time.monotonic(), 0.1))
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
