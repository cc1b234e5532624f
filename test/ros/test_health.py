"""Status reports of nodes, and the simulator's clock."""

import os
import signal
import socket
import time
from collections import defaultdict
from collections.abc import Callable
from io import StringIO
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.node import Node
from rich.console import Console
from rosgraph_msgs.msg import Clock

from rkhs_interfaces.msg import Action, NodeInstance
from rkhs_interfaces.srv import DescribeTask
from rkhs_ros.nodes.core.diagnostics import DIAGNOSTICS_QOS
from rkhs_ros.nodes.core.messages import LOCKSTEP_QOS, start_request
from rkhs_ros.nodes.core.uniqueness import RECEIVER_QOS, SENDER_QOS, TOPIC
from rkhs_ros.nodes.watch.status_node import reasons
from rkhs_ros.policies.messages import doubles
from rkhs_ros.policies.streams import Batch
from test.ros.conftest import ROOT, Probe, Process, kill, nodes_of

Start = Callable[..., Process]
PENDULUM = ROOT / "config" / "pendulum_nac.yaml"
STEP = 0.1  # seconds of the pendulum
KEYS = {"serving version", "batch", "step", "steps per second", "refusals", "ignored", "last refusal", "restarts"}


class Hearing:
    """The newest report of each node, all states and instances it was heard in, and all times that were told."""

    def __init__(self, probe: Probe, clock: str = "clock") -> None:
        self.reports: dict[str, DiagnosticStatus] = {}
        self.states: dict[str, set[tuple[bytes, str]]] = defaultdict(set)
        self.instances: dict[str, list[int]] = defaultdict(list)
        self.times: list[float] = []
        self.listeners = [
            probe.create_subscription(DiagnosticArray, "/diagnostics", self._report, DIAGNOSTICS_QOS),
            probe.create_subscription(NodeInstance, TOPIC, self._meet, RECEIVER_QOS),
            probe.create_subscription(Clock, clock, self._tick, LOCKSTEP_QOS),
        ]

    def value(self, name: str, key: str) -> str:
        return next((v.value for v in self.reports[name].values if v.key == key), "") if name in self.reports else ""

    def _report(self, message: DiagnosticArray) -> None:
        for status in message.status:
            self.reports[status.name] = status
            self.states[status.name].add((status.level, status.message))

    def _meet(self, message: NodeInstance) -> None:
        self.instances[message.node].append(message.instance)

    def _tick(self, message: Clock) -> None:
        self.times.append(message.clock.sec + 1e-9 * message.clock.nanosec)


@pytest.fixture
def run(start: Start, tmp_path: Path) -> Process:
    """A long run over topics."""
    return start("rkhs", "train", PENDULUM, "--quiet", "--iterations", 10_000, "--out", tmp_path / "out")


def test_every_node_reports_its_status_and_restarts(run: Process, probe: Probe) -> None:
    hearing = Hearing(probe)
    nodes = ("/simulator", "/policy", "/learner")
    probe.until(lambda: set(nodes) <= set(hearing.reports))
    probe.until(lambda: all(float(hearing.value(name, "steps per second")) > 0 for name in nodes))
    for name in nodes:
        report = hearing.reports[name]
        assert {value.key for value in report.values} == KEYS
        assert (report.level, hearing.value(name, "restarts")) == (DiagnosticStatus.OK, "0")
        assert report.hardware_id == socket.gethostname()
    kill(*nodes_of(run, "policy"))
    probe.until(lambda: hearing.value("/policy", "restarts") == "1")
    probe.until(lambda: len(set(hearing.instances["/policy"])) == 2)
    assert hearing.instances["/policy"] == sorted(hearing.instances["/policy"])
    assert [len(set(hearing.instances[name])) for name in ("/simulator", "/learner")] == [1, 1]


@pytest.mark.nightly
def test_a_stuck_learner_reports_it_and_the_reason_of_its_exit(start: Start, probe: Probe, tmp_path: Path) -> None:
    hearing = Hearing(probe)
    arguments = ("--quiet", "--iterations", 10_000, "--out", tmp_path / "out", "--set", "timeout=8")
    run = start("rkhs", "train", PENDULUM, *arguments)
    probe.until(lambda: len(probe.heard["episodes"]) > 1)
    (policy,) = nodes_of(run, "policy")
    os.kill(policy, signal.SIGSTOP)
    reason = "the policy node did not answer within 8 s"
    probe.until(lambda: (DiagnosticStatus.ERROR, f"exits: {reason}") in hearing.states["/learner"])
    assert (DiagnosticStatus.ERROR, "stuck: the policy node does not answer") in hearing.states["/learner"]
    assert {level for level, _ in hearing.states["/simulator"]} == {DiagnosticStatus.OK}
    assert f"error: {reason}\n" in run.finish()[2]


def test_a_refusal_is_counted_and_reported(run: Process, probe: Probe) -> None:
    hearing = Hearing(probe)
    probe.until(lambda: len(probe.heard["episodes"]) > 1)

    def told() -> bool:
        probe.say("action", Action(batch=3))  # again and again, since others may be refused after it
        return "batch 3, step 0" in hearing.value("/simulator", "last refusal")

    probe.until(told)
    assert hearing.value("/simulator", "last refusal").startswith("action: expected batch ")


@pytest.mark.nightly
def test_status_prints_the_nodes_and_an_error_without_nodes(
    run: Process, probe: Probe, start: Start, domain: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    ordinary = probe.create_publisher(DiagnosticArray, "/diagnostics", 10)  # no node is to warn of it
    ordinary.publish(DiagnosticArray(status=[DiagnosticStatus(name="a driver")]))
    probe.until(lambda: len(probe.heard["episodes"]) > 1)
    monkeypatch.setenv("COLUMNS", "250")
    code, out, err = start("rkhs", "status").finish()
    assert (code, err) == (0, "")
    rows = [line for line in out.splitlines() if line.startswith("/") and "last refused" not in line]
    assert [row.split()[0] for row in rows] == ["/learner", "/policy", "/simulator"]
    assert all("ok" in row for row in rows)
    run.interrupt()
    assert "incompatible" not in run.finish()[2]
    monkeypatch.setenv("ROS_DOMAIN_ID", str(domain + 101))
    code, out, err = start("rkhs", "status").finish()
    assert (code, out) == (1, "")
    assert err == "error: expected running nodes, got none within 3 s; pass the run's folder, or set ROS_DOMAIN_ID\n"


def test_status_prints_a_refusal_literally() -> None:
    refusal = KeyValue(key="last refusal", value="unknown kernel '[/red]'")
    console = Console(width=250, record=True, file=StringIO())
    console.print(*reasons({"/policy": DiagnosticStatus(level=DiagnosticStatus.OK, values=[refusal])}))
    assert refusal.value in console.export_text()


@pytest.mark.nightly
@pytest.mark.parametrize("victim", ["simulator", "policy", "learner"])
def test_the_clock_never_goes_back(run: Process, probe: Probe, victim: str) -> None:
    hearing = Hearing(probe)
    probe.until(lambda: len(hearing.times) > 300)
    kill(*nodes_of(run, victim))
    time.sleep(0.5)
    count = len(hearing.times)
    probe.until(lambda: len(hearing.times) > count + 300)
    steps = [round(t / STEP, 6) for t in hearing.times]
    assert steps == sorted(set(steps))
    assert sum(after == before + 1 for before, after in pairwise(steps)) > 0.9 * len(steps)


def test_a_late_subscriber_receives_the_clock(start: Start, probe: Probe) -> None:
    start("simulator", "--ros-args", "--params-file", PENDULUM)
    probe.meet("observation")
    probe.until(lambda: probe.ask("describe_task", DescribeTask.Request()).connected)
    batch = Batch(seed=0, first_episode=0, num_envs=1, horizon=1000, explore=False)
    task = probe.ask("describe_task", DescribeTask.Request())
    assert probe.ask("start_episodes", start_request(1, 1, batch, task, 0)).accepted
    hearing, step = Hearing(probe), 0

    def act() -> bool:
        nonlocal step
        if probe.heard["observation"][-1].step == step:
            probe.say("action", Action(batch=1, step=step, policy_version=1, actions=doubles(np.zeros(1))))
            step += 1
        return hearing.times != []

    probe.until(act)
    assert hearing.times[0] == pytest.approx(STEP * step, abs=10 * STEP)  # some steps later, it is heard


class Namesake:
    """A process that publishes as if it were a policy node that was there before."""

    def __init__(self, probe: Probe, name: str) -> None:
        self.node = Node(name, context=probe.context)
        self.said = self.node.create_publisher(NodeInstance, TOPIC, SENDER_QOS)
        probe.create_subscription(NodeInstance, TOPIC, self._hear, RECEIVER_QOS)
        self.heard: list[Any] = []

    def _hear(self, message: NodeInstance) -> None:
        self.heard.append(message)

    def say(self, age: float) -> None:
        self.said.publish(NodeInstance(node="/policy", instance=1, age=age))


@pytest.mark.parametrize(
    ("name", "age", "ends"), [("policy", 0.0, False), ("forger", 1e6, False), ("policy", 1e6, True)]
)
def test_a_node_exits_only_for_an_existing_older_one(
    start: Start, probe: Probe, name: str, age: float, ends: bool
) -> None:
    other = Namesake(probe, name)
    policy = start("policy")
    probe.until(lambda: other.heard != [])
    probe.settle(0.3)  # an age of 0 is no longer one of a process that began at the same time
    other.say(age)
    if ends:
        probe.until(lambda: policy.popen.poll() is not None)
        assert "error: expected one policy node, got an older one that is already running" in policy.finish()[2]
    else:
        probe.settle(1.5)
        assert policy.popen.poll() is None
    other.node.destroy_node()


def test_one_of_simultaneously_started_nodes_stays(start: Start, probe: Probe) -> None:
    policies = [start("policy") for _ in range(3)]
    probe.until(lambda: sum(each.popen.poll() is None for each in policies) == 1)
    probe.settle(1.0)
    (last,) = [each for each in policies if each.popen.poll() is None]
    assert [each.finish()[0] for each in policies if each is not last] == [1, 1]


def test_a_later_node_of_an_older_run_stays(start: Start, probe: Probe) -> None:
    hearing = Hearing(probe)
    younger = start("policy", "--ros-args", "-p", "instance:=1")
    probe.until(lambda: hearing.instances["/policy"] == [1])
    older = start("policy", "--ros-args", "-p", "run_age:=100.0", "-p", "instance:=2")
    probe.until(lambda: younger.popen.poll() is not None)
    assert "an older one that is already running" in younger.finish()[2]
    assert older.popen.poll() is None
