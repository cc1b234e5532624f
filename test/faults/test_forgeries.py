"""Repeated forgeries and floods by a foreign node leave a run bit-identical, or end it with the name of the node."""

import os
import re
import signal
from array import array
from collections.abc import Callable
from copy import deepcopy
from pathlib import Path

import numpy as np
import pytest

from rkhs_interfaces.msg import Action, Episodes, Observation
from rkhs_interfaces.srv import StartEpisodes
from rkhs_ros.nodes.core.messages import LOCKSTEP_QOS, set_policy_request
from test.faults.runs import assert_same_bits
from test.ros.conftest import Probe, Process, probe
from test.ros.test_policy_node import policy
from test.ros.test_strangers import Nodes, finish, in_process, nodes, once_at_step

__all__ = ["in_process", "nodes", "probe"]
Start = Callable[..., Process]
Parameters = Callable[..., Path]


def test_a_node_that_forges_every_action_ends_the_run_with_its_name(
    start: Start, parameters: Parameters, probe: Probe, tmp_path: Path
) -> None:
    nodes = Nodes(start, parameters, probe, tmp_path / "out", "-r", "action:=action_sent")

    def pass_on(message: Action) -> None:
        message.actions = array("d", [np.nextafter(value, 9.0) for value in message.actions])
        probe.say("action", message)

    probe.create_subscription(Action, "action_sent", pass_on, LOCKSTEP_QOS)
    probe.say("action", Action())
    code, err = finish(nodes.learn(), probe)
    assert code == 1
    assert re.fullmatch(
        r"error: the simulator node sent wrong episodes 5 times: environment 0 \(episode 0\), step 0: expected "
        r"the policy's action \[.+\], got \[.+\]; publishers of /observation: /simulator; /action: /probe \(unknown\); "
        r"/episodes: /simulator",
        err.splitlines()[-1],
    )
    assert not (tmp_path / "out" / "policy.npz").exists()


def test_forged_episodes_are_ignored(nodes: Nodes, probe: Probe, tmp_path: Path, in_process: Path) -> None:
    forged = []
    stranger = probe.create_publisher(Episodes, "episodes", LOCKSTEP_QOS)

    def forge(message: Observation) -> None:
        """Publish the episodes of the first batch as those of the current one, before it ends."""
        if message.step < 50 and probe.heard["episodes"]:
            episodes = deepcopy(probe.heard["episodes"][0])
            if episodes.num_envs == message.num_envs:
                episodes.batch, episodes.policy_version = message.batch, message.policy_version
                forged.append(episodes)
                stranger.publish(episodes)

    probe.create_subscription(Observation, "observation", forge, LOCKSTEP_QOS)
    learner = nodes.learn()
    code, err = finish(learner, probe)
    assert code == 0, err
    assert len(forged) > 3
    assert "refused episodes: simulator: environment 0 (episode" in err
    assert_same_bits(tmp_path / "out", in_process)


def test_policies_and_batches_of_a_foreign_node_are_survived(
    nodes: Nodes, probe: Probe, tmp_path: Path, in_process: Path
) -> None:
    """The foreign node copies messages and continues from them."""
    begun = StartEpisodes.Request(environment="rkhs/Toy-v0", options="{}", num_envs=2, horizon=20)
    calls = []

    def disturb(message: Observation) -> None:
        if message.step != 3 or message.seed != 0:
            return
        for number in (message.policy_version, message.policy_version + 1):
            request = set_policy_request(policy(0), number)
            calls.append(probe._services_asked["set_policy"].call_async(request))
        if len(calls) % 12 == 0:
            for number in (message.batch + 1, message.batch):
                begun.batch, begun.policy_version, begun.seed = number, message.policy_version, 1
                calls.append(probe._services_asked["start_episodes"].call_async(deepcopy(begun)))

    probe.create_subscription(Observation, "observation", disturb, LOCKSTEP_QOS)
    code, err = finish(nodes.learn(), probe)
    assert code == 0, err
    answers = [call.result() for call in calls if call.done()]
    assert sum(answer.accepted for answer in answers if not hasattr(answer, "version")) >= 2
    assert sum(answer.accepted for answer in answers if hasattr(answer, "version")) > 2
    assert_same_bits(tmp_path / "out", in_process)


def test_a_forged_policy_with_the_version_of_the_learner_is_replaced(
    nodes: Nodes, probe: Probe, tmp_path: Path, in_process: Path
) -> None:
    """The policy node dies, and its successor first receives a forged policy of that version."""
    learner = nodes.learn()

    def kill() -> None:
        os.kill(learner.popen.pid, signal.SIGSTOP)
        nodes.policy.popen.kill()

    version = once_at_step(probe, 5, kill).policy_version
    nodes.policy.popen.wait()
    nodes.start_policy()
    assert probe.ask("set_policy", set_policy_request(policy(0), version)).accepted
    os.kill(learner.popen.pid, signal.SIGCONT)
    code, err = finish(learner, probe)
    assert code == 0, err
    assert f"the policy node serves a policy of another client as version {version}" in err
    assert_same_bits(tmp_path / "out", in_process)


@pytest.mark.parametrize("lead", [0, 1])
def test_a_node_that_sometimes_answers_first_is_named_or_changes_no_result(
    nodes: Nodes, probe: Probe, tmp_path: Path, in_process: Path, lead: int
) -> None:
    """Forge actions for every observed step, or for the step after it."""
    stranger = probe.create_publisher(Action, "action", LOCKSTEP_QOS)

    def forge(message: Observation) -> None:
        action = Action(batch=message.batch, step=message.step + lead, policy_version=message.policy_version)
        action.actions = array("d", np.full(message.num_envs, 0.75))
        stranger.publish(action)

    probe.create_subscription(Observation, "observation", forge, LOCKSTEP_QOS)
    code, err = finish(nodes.learn(), probe)
    print(f"exit code {code} with {err.count('restarts')} batches taken again")
    if code == 0:
        assert_same_bits(tmp_path / "out", in_process)
    else:
        assert code == 1
        assert re.search("^error: the simulator node sent wrong episodes 5 times: row 0 .+/probe .unknown.", err, re.M)


def test_a_flood_of_policies_and_episodes_leaves_the_results_bit_identical(
    nodes: Nodes, probe: Probe, tmp_path: Path, in_process: Path
) -> None:
    """Send ten foreign policies per observation, and the episodes of another batch ten times."""
    stranger = probe.create_publisher(Episodes, "episodes", LOCKSTEP_QOS)
    sent = {"policies": 0, "episodes": 0}

    def flood(message: Observation) -> None:
        if message.step % 10 != 5:
            return
        for number in range(10):
            probe._services_asked["set_policy"].call_async(set_policy_request(policy(number), 1 + number))
            sent["policies"] += 1
            if probe.heard["episodes"]:
                episodes = deepcopy(probe.heard["episodes"][0])
                episodes.batch, episodes.policy_version = message.batch, message.policy_version
                stranger.publish(episodes)
                sent["episodes"] += 1

    probe.create_subscription(Observation, "observation", flood, LOCKSTEP_QOS)
    code, err = finish(nodes.learn(), probe)
    assert code == 0, err
    print(sent)
    assert min(sent.values()) > 300
    assert_same_bits(tmp_path / "out", in_process)
