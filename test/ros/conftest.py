"""Real nodes in separate processes over DDS, with a ROS domain for each test."""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, suppress
from math import inf
from pathlib import Path
from threading import Thread
from typing import Any

import domain_coordinator
import pytest
import rclpy
from rcl_interfaces.srv import ListParameters
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node

from rkhs_interfaces.msg import Action, Episodes, Observation
from rkhs_interfaces.srv import DescribeTask, SetPolicy, StartEpisodes
from rkhs_ros.app.launcher import write_parameters
from rkhs_ros.base.endings import Stop
from rkhs_ros.nodes.core.messages import LOCKSTEP_QOS
from rkhs_ros.nodes.core.spin import ReportingNode, open_node, serve
from rkhs_ros.nodes.core.transport import LOOPBACK, PROFILES, RANGE
from rkhs_ros.runs.config import load_config
from test.processes import children_of, is_running, of_process

ROOT = Path(__file__).parents[2]
PATIENCE = 90.0  # seconds; far above what anything here takes, beside other busy processes too
MODULES = {
    "simulator": "sim_nodes.simulator_node",
    "simulated_robot": "sim_nodes.robots.simulated_robot_node",
    "axis": "sim_nodes.axis_node",
    "policy": "rkhs_ros.nodes.lockstep.policy_node",
    "robot": "rkhs_ros.nodes.robot.robot_node",
    "gate": "rkhs_ros.nodes.robot.gate_node",
    "learner": "rkhs_ros.nodes.lockstep.learner_node",
    "drawing_learner": "rkhs_ros.app.learner",  # as `ros2 run` and the launch files start it
    "rkhs": "rkhs_ros.app.cli",
    "sender": "test.ros.gate_sender",
    "failing_gate": "test.ros.failing_gate",
}
TYPES = {"observation": Observation, "action": Action, "episodes": Episodes}
SERVICES = {"start_episodes": StartEpisodes, "describe_task": DescribeTask, "set_policy": SetPolicy}


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    for item in items:
        if Path(__file__).parent in item.path.parents:
            item.add_marker(pytest.mark.ros)


@pytest.fixture
def domain(monkeypatch: pytest.MonkeyPatch) -> Iterator[int]:
    """A free domain; processes started in the test inherit it."""
    with domain_coordinator.domain_id() as number:
        monkeypatch.setenv("ROS_DOMAIN_ID", str(number))
        monkeypatch.setenv(RANGE, "SUBNET")  # the probe is in this process, and talks as the nodes do by themselves
        monkeypatch.setenv(PROFILES[0], str(LOOPBACK))
        monkeypatch.setenv("OMP_NUM_THREADS", "1")
        yield number


class Process:
    """A process under test."""

    def __init__(self, name: str, *arguments: object) -> None:
        environment = {k: v for k, v in os.environ.items() if k != "_ROS_WHEELS_BOOTSTRAP_COMPLETE"}
        self.popen = subprocess.Popen(
            [*([sys.executable, "-m", MODULES[name]] if name in MODULES else [name]), *map(str, arguments)],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            env=environment,
        )

    def finish(self) -> tuple[int, str, str]:
        """Wait for the end; return exit code, standard output, and standard error without what is merely told."""
        out, err = self.popen.communicate(timeout=2 * PATIENCE)
        self.told = [line for line in err.splitlines(keepends=True) if line.startswith("[INFO]")]
        return self.popen.returncode, out, "".join(line for line in err.splitlines(True) if line not in self.told)

    def interrupt(self) -> None:
        self.popen.send_signal(signal.SIGINT)


def nodes_of(run: Process, name: str) -> list[int]:
    """Return the process numbers of a run's nodes of that name."""
    return [child for child in children_of(run.popen.pid) if f".{name}_node" in of_process(child, "cmdline")]


def kill(pid: int) -> None:
    with suppress(ProcessLookupError):
        os.kill(pid, signal.SIGKILL)


@pytest.fixture
def start(domain: int) -> Iterator[Callable[..., Process]]:
    """Start processes that end with the test at the latest."""
    processes: list[Process] = []

    def begin(name: str, *arguments: object) -> Process:
        processes.append(Process(name, *arguments))
        return processes[-1]

    yield begin
    nodes = [child for process in processes for child in children_of(process.popen.pid)]
    for process in processes:
        process.popen.kill()
        process.popen.wait()
    end = time.monotonic() + PATIENCE
    while any(map(is_running, nodes)) and time.monotonic() < end:  # what they say last is for no other test to hear
        time.sleep(0.01)


@pytest.fixture
def run_node(domain: int) -> Iterator[Callable[..., ReportingNode]]:
    """Run nodes in threads of this process, where their own processes are not the subject."""
    with ExitStack() as running:

        def begin(kind: Callable[..., ReportingNode], name: str, *arguments: object) -> ReportingNode:
            context, stop = Context(), Stop()
            rclpy.init(args=["--ros-args", *map(str, arguments)], context=context, domain_id=domain)
            running.callback(context.try_shutdown)
            node = kind(name, context=context)
            running.callback(node.destroy_node)
            open_node(node)
            thread = Thread(target=serve, args=(node, stop), daemon=True)
            thread.start()
            running.callback(thread.join)
            running.callback(stop.set)
            return node

        yield begin


@pytest.fixture
def parameters(tmp_path: Path) -> Callable[..., Path]:
    """Write a parameter file with all settings of a config and some changes."""

    def write(config: str, *changes: str) -> Path:
        file = tmp_path / f"{config}.parameters.yaml"
        return write_parameters(load_config(ROOT / "config" / f"{config}.yaml", changes), file)

    return write


class Probe(Node):
    """A node of the test's own: it hears all topics, and speaks on them as others do."""

    def __init__(self, context: Context) -> None:
        super().__init__("probe", context=context)
        self.heard: dict[str, list[Any]] = {topic: [] for topic in TYPES}
        self._listeners = {
            t: self.create_subscription(c, t, self.heard[t].append, LOCKSTEP_QOS) for t, c in TYPES.items()
        }
        self._speakers: dict[str, Any] = {}  # made when first needed: nodes count who speaks on a topic
        self._services_asked = {name: self.create_client(c, name) for name, c in SERVICES.items()}
        self._executor = SingleThreadedExecutor(context=context)
        self._executor.add_node(self)
        self._others: list[Node] = []

    def until(self, condition: Callable[[], bool], seconds: float = PATIENCE) -> None:
        deadline = time.monotonic() + seconds
        while not condition():
            assert time.monotonic() < deadline, "nothing came in time"
            self._executor.spin_once(timeout_sec=0.05)

    def settle(self, seconds: float = 0.3) -> None:
        """Hear what still comes."""
        deadline = time.monotonic() + seconds
        while time.monotonic() < deadline:
            self._executor.spin_once(timeout_sec=0.05)

    def meet(self, topic: str) -> None:
        """Wait until a node speaks on the topic."""
        self.until(lambda: self._listeners[topic].get_publisher_count() > 0)

    def speak(self, topic: str) -> None:
        """Become a publisher of the topic, which some nodes wait for."""
        self._speakers[topic] = self.create_publisher(TYPES[topic], topic, LOCKSTEP_QOS)

    def say(self, topic: str, message: Any) -> None:
        if topic not in self._speakers:
            self.speak(topic)
        self.until(lambda: self._speakers[topic].get_subscription_count() > 1)
        self._speakers[topic].publish(message)

    def add_service(self, name: str, kind: Any) -> None:
        self._services_asked[name] = self.create_client(kind, name)

    def ask(self, service: str, request: Any, again: float = 2.0) -> Any:
        """Return the answer to a request, which is asked again after some seconds."""
        client = self._services_asked[service]
        self.until(client.service_is_ready)
        futures = []

        def answered() -> bool:
            if not futures or time.monotonic() > futures[-1][1] + again:  # an answer may be lost when nodes just met
                futures.append((client.call_async(request), time.monotonic()))
            return any(future.done() for future, _ in futures)

        self.until(answered)
        return next(future.result() for future, _ in futures if future.done())

    def ask_once(self, service: str, request: Any, node: str) -> Any:
        """Return the answer to a request that may act, so that it must not be repeated."""
        self.greet(node)
        return self.ask(service, request, again=inf)

    def greet(self, node: str) -> None:
        """Wait until a node has answered a client that was made later than all else here.

        So it knows the rest of this node, too: no message and no answer is lost.
        """
        greeting = f"{node}/list_parameters"
        if greeting not in self._services_asked:
            self.add_service(greeting, ListParameters)
        self.ask(greeting, ListParameters.Request())

    def add_node(self, name: str, **arguments: Any) -> Node:
        """Return a node of that name, whose messages are handled with the probe's own."""
        self._others.append(Node(name, context=self.context, **arguments))
        self._executor.add_node(self._others[-1])
        return self._others[-1]

    def close(self) -> None:
        self._executor.shutdown()
        for node in (*self._others, self):
            node.destroy_node()


@pytest.fixture
def probe(domain: int) -> Iterator[Probe]:
    context = Context()
    rclpy.init(context=context, domain_id=domain)
    node = Probe(context)
    yield node
    node.close()
    context.try_shutdown()
