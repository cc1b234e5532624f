"""The simulator node accepts only the action that it waits for."""

from array import array
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from rkhs_interfaces.msg import Action
from rkhs_interfaces.srv import StartEpisodes
from rkhs_ros.policies.streams import Batch
from rkhs_ros.rollouts.simulation import Simulation
from sim_nodes.simulator_node import SimulatorNode
from test.ros.conftest import Probe, Process

Start = Callable[..., Process]
BATCH = Batch(seed=3, first_episode=5, num_envs=2, horizon=4, explore=True)


@pytest.fixture
def simulator(run_node: Callable[..., object], parameters: Callable[..., Path], probe: Probe) -> None:
    run_node(SimulatorNode, "simulator", "--params-file", parameters("toy_nac"))
    probe.meet("observation")
    probe.speak("action")


def request(batch: int = 9, **changes: object) -> StartEpisodes.Request:
    numbers = {"batch": batch, "policy_version": 1, "seed": 3, "first_episode": 5, "num_envs": 2, "horizon": 4}
    return StartEpisodes.Request(
        **{"environment": "rkhs/Toy-v0", "options": "{}", "explore": True, **numbers, **changes}
    )


def seen(probe: Probe) -> dict[int, np.ndarray]:
    newest = [each for each in probe.heard["observation"] if each.batch == probe.heard["observation"][-1].batch]
    return {message.step: np.frombuffer(message.observations).reshape(2, 1) for message in newest}


def begin(probe: Probe, batch: int = 9) -> None:
    probe.until(lambda: probe.ask("start_episodes", request(batch)).success)  # once the nodes have met
    probe.until(lambda: probe.heard["observation"][-1:] != [] and probe.heard["observation"][-1].batch == batch)


def action(step: int, values: tuple[float, ...] = (0.5, -0.25), **changes: int) -> Action:
    fields = {"batch": 9, "step": step, "policy_version": 1, **changes}
    return Action(actions=array("d", values), **fields)


def test_an_action_for_another_step_is_ignored(simulator: None, probe: Probe) -> None:
    begin(probe)
    probe.say("action", action(0))
    probe.until(lambda: len(seen(probe)) == 2)
    for message in (action(1, batch=8), action(0), action(2), action(1, policy_version=2), action(1)):
        probe.say("action", message)
    probe.until(lambda: len(seen(probe)) == 3)
    expected = Simulation("rkhs/Toy-v0")
    expected.start(BATCH)
    for _ in range(2):
        frame = expected.step(np.array([[0.5], [-0.25]]))
    np.testing.assert_array_equal(seen(probe)[2], frame.observations)


FAILURES = {
    "actions: expected (2, 1) values, got 1 of them": action(0, (0.5,)),
    "actions: expected finite": action(0, (0.5, float("nan"))),
    "rkhs/Toy-v0: the policy cannot act: it is tired": Action(
        batch=9, policy_version=1, failure="the policy cannot act: it is tired"
    ),
}


def test_actions_that_cannot_be_executed_end_the_batch_with_the_reason(simulator: None, probe: Probe) -> None:
    for count, (reason, message) in enumerate(FAILURES.items(), 1):
        begin(probe)
        probe.say("action", message)
        probe.until(lambda: len(probe.heard["episodes"]) == count)  # noqa: B023  # awaited in this step
        assert reason.split(" values")[0] in probe.heard["episodes"][-1].failure
    begin(probe)
