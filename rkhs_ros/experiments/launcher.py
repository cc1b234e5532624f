"""Starts the three nodes of a run in processes of their own, and ends them together."""

from __future__ import annotations

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

FAILED = 1  # exit code
PATIENCE = 5.0  # seconds that a node has to end after a signal
MODULES = {
    "simulator": "sim_nodes.simulator_node",
    "policy": "rkhs_ros.nodes.policy_node",
    "learner": "rkhs_ros.nodes.learner_node",
}


Nodes = dict[str, subprocess.Popen[bytes]]


def namespaces(simulators: int) -> list[str]:
    """Return the namespaces of that many simulator nodes, relative ones with their slash; none for a single one."""
    return [""] if simulators == 1 else [f"simulator_{k + 1}/" for k in range(simulators)]


def node_names(simulators: int) -> list[str]:
    """Return the names of all nodes of a run, the learner's last."""
    return [*(f"{namespace}simulator" for namespace in namespaces(simulators)), "policy", "learner"]


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
            return _wait(nodes)


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
            nodes[name] = _start(name, ["--params-file", str(parameters), *(extra if name == "learner" else [])])
        yield nodes
    finally:
        _end(nodes)


def _start(name: str, arguments: list[str]) -> subprocess.Popen[bytes]:
    """Start a node outside our foreground group, so that a Ctrl-C reaches it once, through us."""
    namespace, _, kind = name.rpartition("/")
    command = [sys.executable, "-m", MODULES[kind], "--ros-args", "-r", f"__ns:=/{namespace}", *arguments]
    return subprocess.Popen(command, stdin=subprocess.DEVNULL, process_group=0, env=_environment())


def _environment() -> dict[str, str]:
    # The wheels of ROS 2 start Python once more to set the library path, unless this says that they did.
    return {k: v for k, v in os.environ.items() if k != "_ROS_WHEELS_BOOTSTRAP_COMPLETE"}


def _wait(nodes: Nodes) -> int:
    while True:
        for name, process in nodes.items():
            code = process.poll()
            if code is not None and name == "learner":
                return code
            if code is not None:
                return _report_loss(name, code, nodes["learner"])
        time.sleep(0.05)


def _report_loss(name: str, code: int, learner: subprocess.Popen[bytes]) -> int:
    if learner.poll() is None and code <= 0:
        how = f"was killed by signal {-code}" if code else "ended before the learner"
        print(f"error: the {name} node {how}", file=sys.stderr)
    return code if code > 0 else FAILED


@contextmanager
def _signals_passed_to(learner: subprocess.Popen[bytes]) -> Iterator[None]:
    """Let the first signal end the learner, which writes what was learnt; a second one ends us."""

    def pass_on(number: int, frame: FrameType | None) -> None:
        learner.send_signal(signal.SIGINT)
        for each in previous:
            signal.signal(each, signal.default_int_handler)

    previous = {number: signal.signal(number, pass_on) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield
    finally:
        for number, handler in previous.items():
            signal.signal(number, handler)


def _end(nodes: Nodes) -> None:
    for process in nodes.values():
        process.terminate()
    deadline = time.monotonic() + PATIENCE
    for process in nodes.values():
        try:
            process.wait(max(deadline - time.monotonic(), 0.1))
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
