"""The policy node serves one policy throughout a batch, and refuses invalid ones."""

from array import array
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from rkhs_interfaces import msg
from rkhs_interfaces.msg import Action, Observation
from rkhs_interfaces.srv import SetPolicy
from rkhs_ros.nodes.lockstep.policy_node import PolicyNode
from rkhs_ros.policies.gaussian import Acting, GaussianPolicy
from rkhs_ros.policies.inputs import Inputs
from rkhs_ros.policies.messages import policy_message, policy_of
from rkhs_ros.policies.storage import Task, save_policy
from rkhs_ros.policies.streams import Batch
from rkhs_ros.policies.variance import ConstantVariance, FunctionVariance, KernelVariance
from rkhs_ros.rkhs.function import Function
from rkhs_ros.rkhs.kernels import RBF, Linear, Polynomial
from test.ros.conftest import Probe

Start = Callable[..., object]
BATCH = Batch(seed=3, first_episode=5, num_envs=2, horizon=4, explore=True)
SEEN = np.array([[0.3, -1.0], [2.0, 0.5]])


PLAIN, WINDOW = Inputs(), Inputs(history=3, angles=(1.0,), degree=2, offset=0.25)


def policy(seed: int, variance: str = "constant", inputs: Inputs = PLAIN) -> GaussianPolicy:
    rng = np.random.default_rng(seed)
    d = inputs.dimension(2, 1)
    linear = Linear(tuple(rng.normal(size=d)), tuple(rng.uniform(1, 2, d)))
    kernel = RBF(tuple(rng.uniform(1, 2, d))) + Polynomial(0.5, 2)
    mean = Function(kernel + linear, rng.normal(size=(3, d)), 0.1 * rng.normal(size=(3, 1)))
    if variance == "constant":
        return GaussianPolicy(mean, ConstantVariance(np.array([0.5])), inputs)
    centres, values, low, high = rng.normal(size=(2, d)), rng.uniform(1, 2, (2, 1)), np.array([0.5]), np.array([1.5])
    if variance == "function":
        return GaussianPolicy(mean, FunctionVariance(Function(kernel, centres, values), low, high), inputs)
    return GaussianPolicy(mean, KernelVariance(kernel, centres, np.array([1.0, 3.0]), values, low, high), inputs)


def observation(step: int, batch: int = 1, version: int = 1, seen: np.ndarray = SEEN) -> Observation:
    numbers = {"batch": batch, "policy_version": version, "step": step, "horizon": 4, "seed": 3, "num_envs": 2}
    arrays = {"observations": array("d", seen.tobytes()), "rewards": array("d", [0.0, 0.0] if step else [])}
    return Observation(first_episode=5, explore=True, **numbers, **arrays)


def set_policy_request(served: GaussianPolicy, version: int) -> SetPolicy.Request:
    return SetPolicy.Request(policy=policy_message(msg, served, version))


def meet(probe: Probe) -> None:
    probe.speak("observation")
    probe.greet("policy")


def reply(probe: Probe, message: Observation) -> Action:
    count = len(probe.heard["action"])
    probe.say("observation", message)
    probe.until(lambda: len(probe.heard["action"]) > count)
    return probe.heard["action"][-1]


def answer(probe: Probe, message: Observation) -> tuple[int, np.ndarray]:
    heard = reply(probe, message)
    assert (heard.batch, heard.step) == (message.batch, message.step)
    return heard.policy_version, np.frombuffer(heard.actions).reshape(2, 1)


def failure(probe: Probe, message: Observation) -> str:
    return str(reply(probe, message).failure)


def expected(served: GaussianPolicy, step: int) -> np.ndarray:
    return Acting(served, BATCH, explore=True)(step, SEEN)


@pytest.fixture
def node(run_node: Start, probe: Probe) -> None:
    run_node(PolicyNode, "policy")
    meet(probe)
    probe.until(lambda: probe.ask("set_policy", set_policy_request(policy(0), 1)).success)


SERVED = [
    ("constant", WINDOW, "white"),
    ("kernel", PLAIN, "white"),
    ("kernel", WINDOW, "pink"),
    ("function", PLAIN, "pink"),
    ("function", WINDOW, "white"),
]


def test_any_policy_acts_identically_over_topics_and_in_process(node: None, probe: Probe) -> None:
    for number, (variance, inputs, noise) in enumerate(SERVED, 2):
        served = replace(policy(4, variance, inputs), noise=noise)
        assert policy_of(set_policy_request(served, number).policy).noise == noise
        response = probe.ask("set_policy", set_policy_request(served, number))
        assert (response.success, response.message) == (True, "")
        acting = Acting(served, BATCH, explore=True)
        seen = np.random.default_rng(1).normal(size=(4, *SEEN.shape))
        for step in range(4):
            version, actions = answer(probe, observation(step, batch=number, version=number, seen=seen[step]))
            assert version == number
            np.testing.assert_array_equal(actions, acting(step, seen[step]))


def test_a_policy_never_changes_within_a_batch(node: None, probe: Probe) -> None:
    np.testing.assert_array_equal(answer(probe, observation(0))[1], expected(policy(0), 0))
    assert probe.ask("set_policy", set_policy_request(policy(1), 2)).success
    for message in (observation(1), observation(2), observation(3)):
        version, actions = answer(probe, message)
        assert version == 1
        np.testing.assert_array_equal(actions, expected(policy(0), message.step))
    version, actions = answer(probe, observation(0, batch=2, version=2))
    assert version == 2
    np.testing.assert_array_equal(actions, expected(policy(1), 0))


def test_observations_of_another_batch_get_no_answer_and_one_out_of_order_ends_the_batch(
    node: None, probe: Probe
) -> None:
    answer(probe, observation(0, batch=4))
    answer(probe, observation(0, batch=5))
    for late in (observation(1, batch=4), observation(1, batch=5, version=2)):
        probe.say("observation", late)
    assert failure(probe, observation(2, batch=5)) == "the policy cannot act: step: expected 1, the next one, got 2"
    assert [each.batch for each in probe.heard["action"]] == [4, 5, 5]
    assert answer(probe, observation(1, batch=5))[0] == 1


def test_after_a_refused_policy_the_old_one_stays_in_service(node: None, probe: Probe) -> None:
    request = set_policy_request(policy(1), 2)
    request.policy.kernel[0].name = "rbg"
    response = probe.ask("set_policy", request)
    assert not response.success
    assert "did you mean 'rbf'?" in response.message
    version, actions = answer(probe, observation(0))
    assert version == 1
    np.testing.assert_array_equal(actions, expected(policy(0), 0))


def test_a_saved_policy_is_served_without_exploration_noise(run_node: Start, probe: Probe, tmp_path: Path) -> None:
    saved = policy(2, inputs=WINDOW)
    save_policy(tmp_path / "policy.npz", saved, Task("rkhs/Pendulum-v0", {}, 4, 0.99))
    run_node(PolicyNode, "policy", "-p", f"policy_file:={tmp_path / 'policy.npz'}")
    meet(probe)
    done = np.zeros((2, 4, 1))
    for step in range(4):
        points = WINDOW.at(np.array([step]), np.repeat(SEEN[:, None], 4, axis=1), done)[:, 0]
        done[:, step] = saved.mean(points)
        np.testing.assert_array_equal(answer(probe, observation(step, version=0))[1], done[:, step])
    response = probe.ask("set_policy", set_policy_request(policy(0), 1))
    assert not response.success
    assert "file" in response.message
