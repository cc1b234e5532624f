"""Launcher of the nodes of a run, and their ROS domain: starts a process per node, and stops all when one ends."""

import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from functools import partial
from pathlib import Path
from types import FrameType

from rkhs_ros.base.endings import BAD_INPUT, ENDING, FAILED, INTERRUPTED, RESUMABLE, RunError, deferred_signals
from rkhs_ros.base.files import DOMAIN_FILE, is_locked, locked, write_whole
from rkhs_ros.base.processes import python, terminate_with_parent
from rkhs_ros.base.validation import require
from rkhs_ros.base.yaml_text import LEARNER, PARAMETERS, ROBOT, dumped, require_ros_value
from rkhs_ros.nodes.core.transport import node_names
from rkhs_ros.robot.gate_settings import LONGEST_END_S
from rkhs_ros.runs.config import Config

TERMINATION_TIMEOUT_S = 2.0  # from SIGTERM until the node is killed
# The gate first brings the robot to rest, and the simulated robot must run until then.
BRAKING_TIMEOUT_S = dict.fromkeys(("gate", "simulated_robot"), LONGEST_END_S + 2.0)
POLL_INTERVAL_S = 0.05
MOST_RESUMES, WINDOW_S = 5, 300.0  # of a run within the window; one more fault ends it
LEARNING = ("policy", "learner")  # nodes that are not part of the simulator or robot
OWN_CODES = (0, FAILED, BAD_INPUT, RESUMABLE, INTERRUPTED)  # of a node; any other exit code means that it died
DOMAIN = "ROS_DOMAIN_ID"
# A process owns a domain while it binds the port PORT_BASE + domain, as the coordinator of ROS's tests does.
PORT_BASE = 32768
DOMAINS = range(100, 0, -1)  # from the top, since people tend to choose small numbers
MODULES = {
    "simulator": "sim_nodes.simulator_node",
    "gate": "rkhs_ros.nodes.robot.gate_node",
    "robot": "rkhs_ros.nodes.robot.robot_node",
    "simulated_robot": "sim_nodes.robots.simulated_robot_node",
    "policy": "rkhs_ros.nodes.lockstep.policy_node",
    "learner": "rkhs_ros.nodes.lockstep.learner_node",
}


class NodeProcess:
    """A node, named by a key of `MODULES`, in a separate process, which the object owns."""

    def __init__(self, name: str, parameters: Path) -> None:
        self.name = name
        self.is_interrupted = False
        # The launcher prints the progress.
        quiet = ("--log-level", f"{name}:=warn")
        with deferred_signals():  # Python loses an exception that a handler raises during the fork
            self.process = subprocess.Popen(
                [*python(MODULES[name]), "--ros-args", *quiet, "--params-file", str(parameters)],
                stdin=subprocess.DEVNULL,
                process_group=0,  # outside our foreground group: Ctrl-C reaches the node only through the launcher
                # If this variable is set, the wheels of ROS 2 skip the restart of Python that sets the library path.
                env={k: v for k, v in os.environ.items() if k != "_ROS_WHEELS_BOOTSTRAP_COMPLETE"},
                preexec_fn=partial(terminate_with_parent, os.getpid()),
            )

    def interrupt(self) -> None:
        """Stop the node."""
        self.is_interrupted = True
        _terminate_process(self.process)


Nodes = dict[str, NodeProcess]


def launch(config: Config, parameters: Path) -> int:
    """Run the nodes of a run until one ends; return its exit code, or `RESUMABLE` if a node died or was silent."""
    with started(node_names(config.environment.nodes), parameters) as nodes, _signals_passed_to(nodes["learner"]):
        return _supervise(nodes, config.environment.id)


def resuming(run: Callable[[], int], stored: Callable[[], int]) -> int:
    """Run the nodes of a run, and resume it whenever a node has died or fallen silent.

    A run that stores no further iteration is resumed as often at most, however long that takes: it may fail at the same
    step each time.
    """
    resumed: list[float] = []
    code, iterations = run(), 0
    while code == RESUMABLE:
        now, before, iterations = time.monotonic(), iterations, stored()
        if iterations > before:
            resumed = [each for each in resumed if now - each < WINDOW_S]
        if len(resumed) == MOST_RESUMES:
            how = f"{MOST_RESUMES} times within {WINDOW_S:g} s or without a further iteration"
            print(f"error: the run was resumed {how}", file=sys.stderr)
            return FAILED
        resumed.append(now)
        count = f"{len(resumed)} of at most {MOST_RESUMES} times within {WINDOW_S:g} s"
        print(f"warning: the run resumes after iteration {iterations} ({count})", file=sys.stderr)
        code = run()
    return code


def launch_worlds(config: Config, parameters: Path) -> int:
    """Run a simulator, or the nodes of a robot, until one ends; return its exit code."""
    worlds = [name for name in node_names(config.environment.nodes) if name not in LEARNING]
    with started(worlds, parameters) as nodes:
        code = _supervise(nodes, config.environment.id)
    return FAILED if code == RESUMABLE else code


def write_parameters(config: Config, file: Path, **learner: str | bool) -> Path:
    """Write the ROS parameter file of all nodes of a run; return its path."""
    require_ros_value(learner, "learner")
    document, robot = config.parameters(), config.environment.nodes
    document[LEARNER][PARAMETERS] |= {"environment": config.environment.tree(), **learner}
    if robot:
        simulated = "simulated_robot" in robot and robot["gate"].get("arms_itself", False)
        document[ROBOT] = {PARAMETERS: {**robot["robot"], "simulated": simulated}}
    file.parent.mkdir(parents=True, exist_ok=True)
    write_whole(file, dumped(document).encode())
    return file


@contextmanager
def started(names: Iterable[str], parameters: Path) -> Iterator[Nodes]:
    """Start nodes, named by keys of `MODULES`, with a parameter file; stop them when the context exits."""
    nodes: Nodes = {}
    try:
        for name in names:
            nodes[name] = NodeProcess(name, parameters)
        yield nodes
    finally:
        _terminate(nodes.values())


def _supervise(nodes: Nodes, task: str) -> int:
    """Wait until a node ends; return the exit code of the run, and print an error if this was unexpected."""
    while not (ended := [node for node in nodes.values() if node.process.poll() is not None]):
        time.sleep(POLL_INTERVAL_S)
    learner, gate = nodes.get("learner"), nodes.get("gate")
    node = gate if gate in ended else ended[-1]  # the learner is the last one
    code = node.process.returncode
    if learner is not None and learner.is_interrupted:
        return code if node is learner and code > 0 and code != RESUMABLE else INTERRUPTED
    named = f"the {node.name} node" + (f", of {task}," if node.name == "simulator" else "")
    if node is gate:  # a person must check why it ended
        print(f"error: {named} {_how_it_ended(code)}; without it the robot must not move", file=sys.stderr)
        return code if code in (FAILED, BAD_INPUT, INTERRUPTED) else FAILED
    if code not in OWN_CODES:
        print(f"error: {named} {_how_it_ended(code)}", file=sys.stderr)
        return RESUMABLE
    if node is not learner and code != RESUMABLE:
        print(
            f"error: {named} {_how_it_ended(code)} {'unexpectedly' if learner is None else 'before the learner'}",
            file=sys.stderr,
        )
        return code or FAILED
    return code


def _how_it_ended(code: int) -> str:
    return f"was killed by signal {-code}" if code < 0 else f"ended with exit code {code}"


@contextmanager
def _signals_passed_to(learner: NodeProcess) -> Iterator[None]:
    """Stop the learner on the first signal, so that it saves its policy; stop the launcher on the second one."""

    def pass_on(number: int, frame: FrameType | None) -> None:
        for each in previous:
            signal.signal(each, signal.default_int_handler)
        if learner.process.poll() is not None:
            raise KeyboardInterrupt
        learner.interrupt()

    previous = {number: signal.getsignal(number) for number in ENDING}  # before a handler can need them
    try:
        for number in ENDING:
            signal.signal(number, pass_on)
        yield
    finally:
        for number, handler in previous.items():
            signal.signal(number, handler)


def _terminate_process(process: subprocess.Popen[bytes]) -> None:
    """Terminate a process, even if it is suspended by SIGSTOP."""
    process.terminate()  # unlike SIGINT, this prints no traceback while the process imports modules
    process.send_signal(signal.SIGCONT)


def _terminate(nodes: Iterable[NodeProcess]) -> None:
    nodes = list(nodes)
    for node in nodes:
        _terminate_process(node.process)
    begin = time.monotonic()
    for node in nodes:
        deadline = begin + BRAKING_TIMEOUT_S.get(node.name, TERMINATION_TIMEOUT_S)
        try:
            node.process.wait(max(deadline - time.monotonic(), 0.1))
        except subprocess.TimeoutExpired:
            node.process.kill()
            node.process.wait()


@contextmanager
def reserved_domain(folder: Path, default: str | None = None) -> Iterator[None]:
    """Set a ROS domain that no other run uses for the nodes started in this context, and write it to the run's folder.

    A domain set by ROS_DOMAIN_ID stays.
    """
    given, file = os.environ.get(DOMAIN), folder / DOMAIN_FILE  # ROS treats an empty value like none
    with socket.socket() as claim, ExitStack() as active:
        domain = given or default or str(_claimed(claim))
        with locked(folder):  # otherwise the active run could no longer be found
            active.enter_context(locked(folder, DOMAIN_FILE))
            file.write_text(f"{domain}\n")
        os.environ[DOMAIN] = domain
        try:
            yield
        finally:
            if given is None:
                del os.environ[DOMAIN]
            else:
                os.environ[DOMAIN] = given
            with suppress(OSError):
                file.unlink(missing_ok=True)


def domain_of(folder: Path) -> int:
    """Return the ROS domain of an active run; after a crash, another run may use that of its file."""
    require(is_locked(folder, DOMAIN_FILE), f"{folder}", "the folder of an active run over topics", "none")
    return int((folder / DOMAIN_FILE).read_text())


def _claimed(claim: socket.socket) -> int:
    for domain in DOMAINS:
        with suppress(OSError):
            claim.bind(("", PORT_BASE + domain))
            return domain
    raise RunError(f"expected a free ROS domain among {len(DOMAINS)}, got none. Set {DOMAIN}")
