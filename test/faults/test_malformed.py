"""Nodes refuse thousands of malformed messages with a reason, survive, and leave the results bit-identical."""

import re
from array import array
from collections import Counter
from collections.abc import Callable
from copy import deepcopy
from dataclasses import replace
from itertools import count
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray
from hypothesis import HealthCheck, Phase, given, settings
from hypothesis import strategies as st

from rkhs_interfaces.msg import Action, Episodes, NodeInstance, Observation
from rkhs_interfaces.srv import DescribeTask, SetPolicy, StartEpisodes
from rkhs_ros.nodes.core.diagnostics import DIAGNOSTICS_QOS, REPORT_PERIOD_S
from rkhs_ros.nodes.core.messages import observation_message, set_policy_request, start_request
from rkhs_ros.nodes.core.uniqueness import SENDER_QOS, TOPIC
from rkhs_ros.policies.gaussian import Acting, GaussianPolicy
from rkhs_ros.policies.messages import doubles
from rkhs_ros.policies.streams import Batch
from rkhs_ros.rollouts.simulation import Frame, Simulation
from test.faults.runs import assert_same_bits
from test.faults.spoilers import ALWAYS, FREE, THEN, Spoiler, paths, spoil
from test.ros.conftest import Probe, Process, probe
from test.ros.test_policy_node import PLAIN, WINDOW, policy

__all__ = ["probe"]
CASES, IN_THE_RUN = 500, 200  # per kind of message
GROWTH = 200e6  # bytes
TOPICS = {Observation: "observation", Action: "action", Episodes: "episodes"}
SERVICES = {SetPolicy.Request: ("set_policy", "policy"), StartEpisodes.Request: ("start_episodes", "simulator")}
POLICIES = [policy(1, name, inputs) for name in ("constant", "kernel", "function") for inputs in (PLAIN, WINDOW)]
FOREIGN = 9  # version of a policy that the policy node does not have
BATCH = Batch(3, first_episode=5, num_envs=20, horizon=50, explore=True, num_evaluation=6, first_evaluation=2)
EPISODE = {"observations": 2, "actions": 1, "rewards": 1}
TASK = DescribeTask.Response(environment="rkhs/Pendulum-v0", options='{"angle": "clip"}')


class Intruder:
    """Sends malformed messages and counts the corrupted fields.

    Owns what the nodes reported last, and their reasons.
    """

    def __init__(self, probe: Probe) -> None:
        self.probe = probe
        self.spoilt: dict[type, Counter[str]] = {kind: Counter() for kind in ALWAYS}
        self.reasons: set[str] = set()
        self._refused: dict[str, int] = {}
        self._listener = probe.create_subscription(DiagnosticArray, "/diagnostics", self._hear, DIAGNOSTICS_QOS)

    def _hear(self, message: DiagnosticArray) -> None:
        for status in message.status:
            values = {value.key: value.value for value in status.values}
            self._refused[status.name] = int(values["refusals"]) + int(values["ignored"])
            self.reasons |= {values["last refusal"]} - {""}

    def spoil(self, data: st.DataObject, message: Any, spoilers: dict[str, Spoiler], **live: Any) -> Any:
        """Return a copy of a message with one corrupted field and current values in the others."""
        path = data.draw(st.sampled_from(sorted(spoilers)))
        spoilt = deepcopy(message)
        spoil(data, spoilt, path, spoilers[path])
        for name, value in live.items():
            if name != path:
                setattr(spoilt, name, value)
        self.spoilt[type(message)][path] += 1
        return spoilt

    def say(self, message: Any) -> None:
        self.probe.say(TOPICS[type(message)], message)

    def refused(self, request: Any) -> None:
        """Call a service with a malformed request, and assert a refusal with a one-line reason."""
        service, node = SERVICES[type(request)]
        response = self.probe.ask_once(service, request, node)  # refusals are counted
        assert not response.accepted
        assert_reason(response.message)

    def count(self, node: str, expected: int = 0) -> int:
        """Wait until a node has refused or ignored the expected number of messages, and return the number."""
        self.probe.until(lambda: self._refused.get(node, -1) >= expected, 5.0)
        self.probe.settle(1.5 * REPORT_PERIOD_S)
        return self._refused[node]


def assert_reason(reason: str) -> None:
    assert re.search("expected .+, got .|unknown .+, (known:|did you mean) .", reason), reason
    assert len(reason) < 500
    assert reason.isprintable()


def cases(check: Callable[[st.DataObject], None], count: int) -> None:
    """Generate a number of cases, deterministically."""
    quiet = settings(
        max_examples=count,
        derandomize=True,
        database=None,
        deadline=None,
        phases=[Phase.generate],
        suppress_health_check=list(HealthCheck),
    )
    quiet(given(st.data())(check))()


def assert_well(process: Process) -> None:
    code, out, err = process.finish()
    assert (code, out) == (0, "")
    for line in err.splitlines():
        told = r"(refused|expected one publisher, got|the batch of the simulator node restarts;) "
        assert re.match(r"\[WARN\] \[[\d.]+\] \[\w+\]: " + told, line), err


def memory(process: Process, what: str) -> float:
    status = Path(f"/proc/{process.popen.pid}/status").read_text()
    return 1024 * float(re.search(rf"^{what}:\s*(\d+) kB", status, re.MULTILINE)[1])


def matrix(values: array) -> np.ndarray:
    return np.frombuffer(values).reshape(BATCH.num_envs, -1)


def any_policy(data: st.DataObject) -> SetPolicy.Request:
    return set_policy_request(POLICIES[data.draw(st.integers(0, len(POLICIES) - 1))], 2)


def both(kind: type) -> dict[str, Spoiler]:
    return ALWAYS[kind] | THEN.get(kind, {})


@pytest.mark.parametrize("kind", ALWAYS, ids=str)
def test_every_field_of_a_message_has_a_spoiler(kind: type) -> None:
    assert set(both(kind)) == set(paths(kind)) - FREE[kind]


def refuse_policies(intruder: Intruder) -> None:
    def check(data: st.DataObject) -> None:
        intruder.refused(intruder.spoil(data, any_policy(data), both(SetPolicy.Request)))

    cases(check, CASES)


def refuse_observations(intruder: Intruder, served: GaussianPolicy) -> None:
    """Send malformed observations before the first or second step of many batches; valid ones are still answered."""
    heard, identities = intruder.probe.heard["action"], count(1)
    simulation, acting = Simulation(TASK.environment), Acting(served, BATCH, explore=True)
    frames = [simulation.start(BATCH), simulation.step(np.ones((BATCH.num_envs, 1)))]
    good = [observation_message(0, 1, BATCH, step, frame) for step, frame in enumerate(frames)]
    others = [
        frame._replace(observations=frame.observations + 0.1) for frame in frames
    ]  # to detect an answer, which would differ
    bad = [observation_message(0, 1, BATCH, step, frame) for step, frame in enumerate(others)]
    expected = [acting(step, frame.observations) for step, frame in enumerate(frames)]

    def check(data: st.DataObject) -> None:
        identity, before = next(identities), len(heard)
        at, step, following = ((0, 0, 0), (1, 1, 0), (1, 0, 1))[data.draw(st.integers(0, 2))]
        spoilers = both(Observation) if step else ALWAYS[Observation]
        spoilt = intruder.spoil(data, bad[step], spoilers, batch=identity + following)
        for message in good:
            if message.step == at:
                intruder.say(spoilt)
            message.batch = identity
            intruder.say(message)
            intruder.probe.until(lambda: len(heard) > before + message.step)  # noqa: B023  # awaited here
        assert [(answer.batch, answer.step) for answer in heard[before:]] == [(identity, 0), (identity, 1)]
        np.testing.assert_array_equal([matrix(answer.actions) for answer in heard[before:]], expected)

    cases(check, CASES)


def refuse_starts(intruder: Intruder) -> None:
    """Request the current and the next batch in malformed ways while a batch is at its first step."""
    now = start_request(1, FOREIGN, BATCH, TASK, 7)
    following = start_request(2, FOREIGN, replace(BATCH, first_episode=25), TASK, 7)
    known, unknown = dict(both(StartEpisodes.Request)), dict(ALWAYS[StartEpisodes.Request])
    unknown["batch"] = known.pop("batch")
    assert intruder.probe.ask("start_episodes", now).accepted
    task = intruder.probe.ask("describe_task", DescribeTask.Request())

    def check(data: st.DataObject) -> None:
        asked, spoilers = ((now, known), (following, unknown))[data.draw(st.integers(0, 1))]
        intruder.refused(intruder.spoil(data, asked, spoilers))
        assert intruder.probe.ask("describe_task", DescribeTask.Request()) == task

    cases(check, CASES)


def refuse_actions(intruder: Intruder) -> None:
    """Send malformed actions before the second step of many batches; the valid action is still accepted."""
    heard, identities = intruder.probe.heard["observation"], count(2)
    simulation, actions = Simulation(TASK.environment), np.linspace(-2, 2, BATCH.num_envs)[:, None]
    simulation.start(BATCH)
    expected = [simulation.step(actions).observations for _ in range(2)]
    good = [Action(step=step, policy_version=FOREIGN, actions=doubles(actions)) for step in range(2)]
    bad = Action(step=1, policy_version=FOREIGN, actions=doubles(-actions))  # would change the result

    def check(data: st.DataObject) -> None:
        identity = next(identities)
        spoilt = intruder.spoil(data, bad, both(Action), batch=identity)
        assert intruder.probe.ask("start_episodes", start_request(identity, FOREIGN, BATCH, TASK, 7)).accepted
        for message in good:
            if message.step == 1:
                intruder.say(spoilt)
            message.batch = identity
            intruder.say(message)
            now = (identity, message.step + 1)
            intruder.probe.until(lambda: heard != [] and (heard[-1].batch, heard[-1].step) == now)  # noqa: B023
            np.testing.assert_array_equal(matrix(heard[-1].observations), expected[message.step])

    cases(check, CASES)


def disturb(intruder: Intruder, learner: Process) -> None:
    """Send malformed messages of all kinds during a run."""
    heard, rows, horizon = intruder.probe.heard["observation"], 10, 100
    batch = Batch(0, 0, rows, horizon, explore=True)
    numbers = {name: doubles(np.zeros(rows * horizon * d)) for name, d in EPISODE.items()}
    numbers |= {"final_observations": doubles(np.zeros(rows * 2)), "terminated": [False] * rows}
    episodes = Episodes(num_envs=rows, horizon=horizon, lengths=array("I", [horizon] * rows), **numbers)
    frame = Frame(np.zeros((rows, 2)), np.zeros(rows), np.ones(rows, bool), *np.zeros((2, rows), bool))
    observation = observation_message(0, 0, batch, 1, frame)
    action = Action(actions=doubles(np.zeros(rows)))
    start = start_request(1, 1, batch, TASK, 0)
    at_any_step = THEN[Observation] | ALWAYS[Observation]

    def check(data: st.DataObject) -> None:
        intruder.probe.until(lambda: heard != [] and heard[-1].step > 0)
        seen = {name: getattr(heard[-1], name) for name in Observation.get_fields_and_field_types()}
        now = {name: seen[name] for name in ("batch", "policy_version")}
        disguised = intruder.spoil(data, observation, at_any_step, **seen)
        if disguised != heard[-1]:
            if disguised.observations == heard[-1].observations:
                disguised.observations = observation.observations  # to detect an answer, which would differ
            intruder.say(disguised)
        intruder.say(intruder.spoil(data, action, ALWAYS[Action], **now, step=seen["step"]))
        intruder.say(intruder.spoil(data, episodes, ALWAYS[Episodes], **now))
        intruder.refused(intruder.spoil(data, start, ALWAYS[StartEpisodes.Request], **now))
        intruder.refused(intruder.spoil(data, any_policy(data), ALWAYS[SetPolicy.Request]))
        assert learner.popen.poll() is None

    cases(check, IN_THE_RUN)


@pytest.mark.timeout(300)
def test_malformed_messages_are_refused_with_a_reason_and_leave_the_results_bit_identical(
    start: Callable[..., Process], parameters: Callable[..., Path], probe: Probe, tmp_path: Path, undisturbed: Path
) -> None:
    file = parameters("pendulum_nac")
    nodes = [start("simulator", "--ros-args", "--params-file", file), start("policy")]
    for topic in ("observation", "action"):
        probe.meet(topic)
    assert probe.ask("set_policy", set_policy_request(policy(0), 1)).accepted
    intruder = Intruder(probe)
    before = [memory(node, "VmRSS") for node in nodes]

    refused = intruder.count("/policy")
    refuse_policies(intruder)
    refuse_observations(intruder, policy(0))
    assert intruder.count("/policy", refused + 2 * CASES) == refused + 2 * CASES
    refused = intruder.count("/simulator")
    refuse_starts(intruder)
    refuse_actions(intruder)
    assert intruder.count("/simulator", refused + 2 * CASES) == refused + 2 * CASES
    assert [sum(counts.values()) for kind, counts in intruder.spoilt.items() if kind is not Episodes] == [CASES] * 4

    folder = tmp_path / "run"
    learner = start("learner", "--ros-args", "--params-file", file, "-p", f"output:={folder}", "-p", "quiet:=true")
    disturb(intruder, learner)
    strangers = probe.create_publisher(NodeInstance, TOPIC, SENDER_QOS)
    for name in ("/policy" * 5000, "policy", ""):
        strangers.publish(NodeInstance(node=name, instance=0))
    assert_well(learner)
    assert_same_bits(folder, undisturbed)

    print({kind.__name__: sum(counts.values()) for kind, counts in intruder.spoilt.items()})
    assert all(set(counts) == set(paths(kind)) - FREE[kind] for kind, counts in intruder.spoilt.items())
    assert intruder.reasons
    for reason in intruder.reasons:
        assert_reason(reason)
    for node, taken in zip(nodes, before, strict=True):
        assert memory(node, "VmHWM") < taken + GROWTH
        node.interrupt()
        assert_well(node)
