"""Starts the nodes of a run in processes of their own, starts again those that die, and ends them together."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections import deque
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from types import FrameType
from typing import Any, NamedTuple

from rkhs_ros.base.endings import BAD_INPUT, ENDING, FAILED, INTERRUPTED, signals_held
from rkhs_ros.base.files import write_whole
from rkhs_ros.base.parameter_files import LEARNER, PARAMETERS, POLICY, ROBOT, SIMULATED_ROBOT, SIMULATOR
from rkhs_ros.base.processes import terminate_with_parent
from rkhs_ros.base.yaml_text import dumped, loaded, require_ros_value
from rkhs_ros.nodes.core.names import node_names
from rkhs_ros.runs.config import Config, environment_of_robot, robot_nodes

TERMINATION_TIMEOUT_S = 2.0  # for a node to end after SIGTERM, before it is killed
# The same for nodes that first bring a robot to rest: those that brake it, and what is braked.
BRAKING_TIMEOUT_S = {"gate": 10.0, "simulated_robot": 6.0}
POLL_INTERVAL_S = 0.05
MOST_DEATHS, DEATHS_WINDOW_S = 10, 300.0  # of a node in that time; with one more the run is given up
SHORTEST_BACKOFF_S, LONGEST_BACKOFF_S = 0.05, 5.0  # before a node is started again; doubled with each death
NEVER_AGAIN = ("gate",)  # nodes that are not started again: what they stopped for is for a person to look at
LEARNING = ("policy", "learner")  # nodes that are no part of a world
OWN_CODES = (0, FAILED, BAD_INPUT, INTERRUPTED)  # that a node ends with itself; with any other it died
COMPOSED = "simulator+policy"  # nodes that share a process are named together
MODULES = {
    "simulator": "sim_nodes.simulator_node",
    COMPOSED: "sim_nodes.composed_node",
    "gate": "rkhs_ros.nodes.robot.gate_node",
    "robot": "rkhs_ros.nodes.robot.robot_node",
    "simulated_robot": "sim_nodes.robots.simulated_robot_node",
    "policy": "rkhs_ros.nodes.lockstep.policy_node",
    "learner": "rkhs_ros.nodes.lockstep.learner_node",
    "recorder": "rkhs_ros.nodes.watch.recorder_node",
    "status": "rkhs_ros.nodes.watch.status_node",
    "monitor": "rkhs_ros.nodes.watch.monitor_node",
    "operator": "rkhs_ros.nodes.watch.operator_node",
}


class Moment(NamedTuple):
    """When a run began: in nanoseconds of the system's clock, and in seconds of the one that is never set."""

    stamp: int
    monotonic: float


class NodeProcess:
    """A node in a process of its own, which can be started again.

    Owns the process and the times of its latest deaths.

    Args:
        name: a key of `MODULES`, after a namespace and a slash if need be.
        arguments: of the node, after ``--ros-args``.
        began: when its run began; None for a node without a run.
    """

    def __init__(self, name: str, arguments: Sequence[str] = (), began: Moment | None = None) -> None:
        self.name = name
        self._arguments = list(arguments)
        self._began = began
        self._restarts = 0
        self._deaths: deque[float] = deque(maxlen=MOST_DEATHS + 1)
        self._restart_at: float | None = None
        self.is_interrupted = False
        self.process = self._start()

    def poll(self) -> int | None:
        """Return the exit code if the node ended; start it again when that is due."""
        if self._restart_at is None:
            return self.process.poll()
        if time.monotonic() >= self._restart_at:
            self._restart_at = None
            self._restarts += 1
            self.process = self._start()
        return None

    def interrupt(self) -> None:
        """Have the node end, and not be started again."""
        self.is_interrupted = True
        self._restart_at = None
        _tell_to_end(self.process)

    def restart_later(self) -> bool:
        """Have a node that died started again after a back-off; return False where it died too often."""
        now = time.monotonic()
        self._deaths.append(now)
        recent = sum(now - death < DEATHS_WINDOW_S for death in self._deaths)
        if recent > MOST_DEATHS:
            return False
        backoff = min(SHORTEST_BACKOFF_S * 2 ** (recent - 1), LONGEST_BACKOFF_S)
        print(
            f"warning: the {self.name} node {_how_it_ended(self.process.returncode)}; "
            f"starting it again in {backoff:g} s ({recent} of {MOST_DEATHS} times within {DEATHS_WINDOW_S:g} s)",
            file=sys.stderr,
        )
        self._restart_at = now + backoff
        return True

    def _start(self) -> subprocess.Popen[bytes]:
        """Start the node outside our foreground group, so that a Ctrl-C reaches it once, through us."""
        namespace, _, kind = self.name.rpartition("/")
        more = [f"restarts:={self._restarts}"] if self._restarts else []
        if self._began:
            age = time.monotonic() - self._began.monotonic
            more += [f"instance:={self._began.stamp + self._restarts}", f"run_age:={age:.6f}"]
        more += ["resume:=true"] if self._restarts and kind == "learner" else []
        loggers = self.name.replace("/", ".").split("+")
        quiet = [word for name in loggers for word in ("--log-level", f"{name}:=warn")]  # we say ourselves what is well
        ros = ["--ros-args", *quiet, "-r", f"__ns:=/{namespace}", *self._arguments, *assigned(more)]
        with signals_held():  # Python loses what a handler raises while it forks
            return subprocess.Popen(
                [sys.executable, "-P", "-m", MODULES[kind], *ros],
                stdin=subprocess.DEVNULL,
                process_group=0,
                env=environment(),
                preexec_fn=partial(terminate_with_parent, os.getpid()),
            )


Nodes = dict[str, NodeProcess]


Further = Mapping[str, Mapping[str, str | bool]]  # parameters of nodes, by the nodes' names


def launch(parameters: str, further: Further, *, simulators: int = 1, composed: bool = False) -> int:
    """Run the nodes until the learner ends.

    Args:
        parameters: content of a ROS parameter file.
        further: parameters of nodes, such as paths. The recorder runs where it has some.
        simulators: number of simulator nodes, of more than one each in a namespace of its own.
        composed: whether the single simulator and the policy node share a process.

    Returns:
        The learner's exit code, or that of a node that ended before it.
    """
    document = loaded(parameters)
    recorder = [name for name in further if name == "recorder"]
    names = [COMPOSED, "learner"] if composed else node_names(simulators, robot_nodes(document))
    with (
        _in_memory(for_all(parameters, simulators, further)) as file,
        started([*recorder, *names], file) as nodes,
        _signals_passed_to(nodes["learner"]),
    ):
        return _supervise(nodes, _environment_in(document)["id"])


def launch_worlds(parameters: str, simulators: int) -> int:
    """Run simulators, or the nodes of a robot, until one ends; those that die are started again.

    Args:
        parameters: content of a ROS parameter file.
        simulators: number of simulator nodes, of more than one each in a namespace of its own.

    Returns:
        The exit code of the node that ended.
    """
    document = loaded(parameters)
    worlds = [name for name in node_names(simulators, robot_nodes(document)) if name not in LEARNING]
    with _in_memory(for_all(parameters, simulators)) as file, started(worlds, file) as nodes:
        return _supervise(nodes, _environment_in(document)["id"])


@contextmanager
def _in_memory(content: str) -> Iterator[Path]:
    """Yield a file for the nodes to read that no disk holds, so that nothing is left of it however we end."""
    with os.fdopen(os.memfd_create("parameters.yaml"), "w") as file:
        file.write(content)
        file.flush()
        yield Path(f"/proc/{os.getpid()}/fd/{file.fileno()}")


def for_all(parameters: str, simulators: int, further: Further | None = None) -> str:
    """Return the parameter file of all nodes.

    Args:
        parameters: content of a ROS parameter file. A robot to practise on has its gate armed without a person.
        simulators: number of simulator nodes. Their environment goes to the learner, too, which refuses simulators of
            another.
        further: parameters of nodes, such as paths: as arguments they would be read as YAML.

    Raises:
        ValueError: one of these can be no ROS parameter.
    """
    document = loaded(parameters)
    own: dict[str, dict[str, Any]] = {
        LEARNER: {"environment": _environment_in(document)},
        POLICY: {"simulators": simulators},
    }
    if ROBOT in document:
        own[ROBOT] = {"simulated": SIMULATED_ROBOT in document}
    for name, given in (further or {}).items():
        require_ros_value(given, name)
        own[f"/**/{name}"] = {**own.get(f"/**/{name}", {}), **given}
    for name, added in own.items():
        document[name] = {PARAMETERS: document.get(name, {PARAMETERS: {}})[PARAMETERS] | added}
    return dumped(document)


def robot_parameters(config: Config, folder: Path, *, resume: bool, simulated: bool) -> Path:
    """Write the parameter file of all nodes that learn on a robot into the folder of the run; return it.

    Args:
        config: of the run.
        folder: of its results; made where it is missing.
        resume: whether the learner goes on with what is in the folder.
        simulated: whether the robot is the configuration's simulated robot, and its gate armed without a person.

    Raises:
        ValueError: a setting can be no ROS parameter.
        OSError: the file cannot be written.
    """
    document = config.parameters()
    if not simulated:
        document.pop(SIMULATED_ROBOT, None)
    further: Further = {
        "learner": {"output": str(folder), "resume": resume},
        "robot": {"journal": journal_in(folder)},
    }
    file = folder / "checkpoints" / "parameters.yaml"
    write_whole(file, for_all(dumped(document), 1, further).encode())
    return file


def journal_in(folder: Path) -> str:
    """Return where in the folder of a run a robot keeps its episodes, made before anything starts.

    Raises:
        OSError: there is a file in its place.
    """
    journal = folder / "checkpoints" / "episodes"
    journal.mkdir(parents=True, exist_ok=True)
    return str(journal)


def _environment_in(document: Mapping[str, Any]) -> dict[str, Any]:
    """Return the environment of a parameter file, as the learner is told it."""
    if ROBOT not in document:
        return dict(document[SIMULATOR][PARAMETERS]["environment"])
    return environment_of_robot(robot_nodes(document)).tree()


@contextmanager
def started(names: Iterable[str], parameters: Path) -> Iterator[Nodes]:
    """Start nodes, and end those that still run at the exit of the context.

    Args:
        names: keys of `MODULES`, after a namespace and a slash if need be.
        parameters: a ROS parameter file.
    """
    nodes: Nodes = {}
    began = Moment(time.time_ns(), time.monotonic())
    try:
        for name in names:
            nodes[name] = NodeProcess(name, ["--params-file", str(parameters)], began)
        yield nodes
    finally:
        _terminate(nodes.values())


def assigned(parameters: Iterable[str]) -> list[str]:
    """Return the words that give a node its parameters, from ``name:=value`` each."""
    return [word for assignment in parameters for word in ("-p", assignment)]


def environment() -> dict[str, str]:
    """Return the environment of a node's process."""
    # The wheels of ROS 2 start Python once more to set the library path, unless this says that they did.
    return {k: v for k, v in os.environ.items() if k != "_ROS_WHEELS_BOOTSTRAP_COMPLETE"}


def _supervise(nodes: Nodes, task: str) -> int:
    """Restart the nodes that die until one ends, and return the run's exit code."""
    while True:
        for node in nodes.values():
            code = node.poll()
            again = code not in OWN_CODES and not node.is_interrupted and node.name not in NEVER_AGAIN
            if code is None or (again and node.restart_later()):
                continue
            return _code_at_end(node, code, task, "before the learner" if "learner" in nodes else "unasked")
        time.sleep(POLL_INTERVAL_S)


def _code_at_end(node: NodeProcess, code: int, task: str, when: str) -> int:
    """Return the run's exit code where a node ended with this one and is not started again, and say when."""
    if node.is_interrupted:
        return max(code, 0) or INTERRUPTED
    named = f"the {node.name} node" + (f", of {task}," if "simulator" in node.name else "")
    if node.name in NEVER_AGAIN:
        print(f"error: {named} {_how_it_ended(code)}; nothing may move without it", file=sys.stderr)
        return code if code in OWN_CODES[1:] else FAILED
    if code not in OWN_CODES:
        print(f"error: {named} died more than {MOST_DEATHS} times within {DEATHS_WINDOW_S:g} s", file=sys.stderr)
        return FAILED
    if node.name != "learner":
        print(f"error: {named} {_how_it_ended(code)} {when}", file=sys.stderr)
        return code or FAILED
    return code


def _how_it_ended(code: int) -> str:
    return f"was killed by signal {-code}" if code < 0 else f"ended with exit code {code}"


@contextmanager
def _signals_passed_to(learner: NodeProcess) -> Iterator[None]:
    """Let the first signal end the learner, which writes what was learnt; a second one ends us."""

    def pass_on(number: int, frame: FrameType | None) -> None:
        for each in previous:
            signal.signal(each, signal.default_int_handler)
        if learner.process.poll() is not None:
            raise KeyboardInterrupt
        learner.interrupt()

    previous = {number: signal.getsignal(number) for number in ENDING}  # before a signal can ask for them
    try:
        for number in ENDING:
            signal.signal(number, pass_on)
        yield
    finally:
        for number, handler in previous.items():
            signal.signal(number, handler)


def _tell_to_end(process: subprocess.Popen[bytes]) -> None:
    """Have a process end, one that was stopped (SIGSTOP) as well, which would not hear of it."""
    process.terminate()  # while it imports it dies of this without words, unlike of SIGINT
    process.send_signal(signal.SIGCONT)


def _terminate(nodes: Iterable[NodeProcess]) -> None:
    nodes = list(nodes)
    for node in nodes:
        _tell_to_end(node.process)
    begin = time.monotonic()
    for node in nodes:
        deadline = begin + BRAKING_TIMEOUT_S.get(node.name, TERMINATION_TIMEOUT_S)
        try:
            node.process.wait(max(deadline - time.monotonic(), 0.1))
        except subprocess.TimeoutExpired:
            node.process.kill()
            node.process.wait()
