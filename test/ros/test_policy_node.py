"""The policy node serves one policy from the first step of a batch to its last, and refuses what is none."""

from array import array
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from rkhs_interfaces.msg import Observation
from rkhs_interfaces.srv import SetPolicy
from rkhs_ros.nodes.messages import set_policy_request
from rkhs_ros.policies.gaussian import Acting, GaussianPolicy
from rkhs_ros.policies.storage import Task, save_policy
from rkhs_ros.policies.streams import Batch
from rkhs_ros.policies.variance import ConstantVariance, KernelVariance
from rkhs_ros.rkhs.function import Function
from rkhs_ros.rkhs.kernels import RBF, Polynomial
from test.ros.conftest import Probe, Process

Start = Callable[..., Process]
BATCH = Batch(seed=3, first_episode=5, rows=2, horizon=4, explore=True)
SEEN = np.array([[0.3, -1.0], [2.0, 0.5]])


def policy(seed: int, *, learnt: bool = False) -> GaussianPolicy:
    rng = np.random.default_rng(seed)
    kernel = RBF((1.0, 2.0)) + Polynomial(0.5, 2)
    mean = Function(kernel, rng.normal(size=(3, 2)), rng.normal(size=(3, 1)))
    if not learnt:
        return GaussianPolicy(mean, ConstantVariance(np.array([0.5])))
    variance = KernelVariance(kernel, rng.normal(size=(2, 2)), np.ones(2), np.ones((2, 1)), np.ones(1), np.ones(1))
    return GaussianPolicy(mean, variance)


def observation(step: int, batch: int = 1) -> Observation:
    return Observation(
        batch=batch,
        step=step,
        horizon=4,
        seed=3,
        first_episode=5,
        explore=True,
        rows=2,
        observations=array("d", SEEN.tobytes()),
    )


def answer(probe: Probe, message: Observation) -> tuple[int, np.ndarray]:
    count = len(probe.heard["action"])
    probe.say("observation", message)
    probe.until(lambda: len(probe.heard["action"]) > count)
    heard = probe.heard["action"][-1]
    assert (heard.batch, heard.step) == (message.batch, message.step)
    return heard.policy_version, np.frombuffer(heard.actions).reshape(2, 1)


def expected(served: GaussianPolicy, step: int) -> np.ndarray:
    return Acting.start(served, BATCH)(step, SEEN)


@pytest.fixture
def node(start: Start, probe: Probe) -> Process:
    process = start("policy")
    probe.meet("action")
    assert probe.ask("set_policy", set_policy_request(policy(0), 1)).accepted
    return process


@pytest.mark.parametrize("learnt", [False, True])
def test_any_policy_acts_over_topics_as_in_process(node: Process, probe: Probe, learnt: bool) -> None:
    served = policy(4, learnt=learnt)
    response = probe.ask("set_policy", set_policy_request(served, 2))
    assert (response.accepted, response.version, response.message) == (True, 2, "")
    for step in range(4):
        version, actions = answer(probe, observation(step))
        assert version == 2
        np.testing.assert_array_equal(actions, expected(served, step))


def test_a_swap_never_lands_inside_a_batch(node: Process, probe: Probe) -> None:
    np.testing.assert_array_equal(answer(probe, observation(0))[1], expected(policy(0), 0))
    assert probe.ask("set_policy", set_policy_request(policy(1), 2)).accepted
    for message in (observation(1), observation(0), observation(2), observation(3)):  # the second is a duplicate
        version, actions = answer(probe, message)
        assert version == 1
        np.testing.assert_array_equal(actions, expected(policy(0), message.step))
    version, actions = answer(probe, observation(0, batch=2))
    assert version == 2
    np.testing.assert_array_equal(actions, expected(policy(1), 0))


def test_a_duplicate_is_answered_alike_and_a_late_batch_not_at_all(node: Process, probe: Probe) -> None:
    answer(probe, observation(0, batch=5))
    first, again = answer(probe, observation(1, batch=5)), answer(probe, observation(1, batch=5))
    np.testing.assert_array_equal(first[1], again[1])
    count = len(probe.heard["action"])
    for late in (observation(1, batch=4), observation(0, batch=4), observation(4, batch=5)):
        probe.say("observation", late)
    probe.settle()
    assert len(probe.heard["action"]) == count


def spoil(name: str) -> SetPolicy.Request:
    request = set_policy_request(policy(1), 2)
    p = request.policy
    if name == "weights not finite":
        p.weights = array("d", [float("nan"), 1.0, 2.0])
    elif name == "centres infinite":
        p.centres = array("d", [float("inf")] + [0.0] * 5)
    elif name == "weights too few":
        p.weights = array("d", [1.0])
    elif name == "centres ragged":
        p.centres = array("d", [1.0] * 5)
    elif name == "unknown kernel":
        p.kernel[0].name = "rbg"
    elif name == "kernel incomplete":
        p.kernel = p.kernel[-1:]
    elif name == "bandwidths of another dimension":
        p.kernel[0].parameters = array("d", [1.0] * 3)
    elif name == "variance negative":
        p.variance.values = array("d", [-1.0])
    elif name == "variance unknown":
        p.variance.name = "constnt"
    elif name == "no dimensions":
        p.observation_dim = 0
    return request


@pytest.mark.parametrize(
    ("name", "reason"),
    [
        ("weights not finite", "weights: expected finite"),
        ("centres infinite", "centres: expected finite"),
        ("weights too few", "weights: expected (3, 1)"),
        ("centres ragged", "centres: expected rows of 2"),
        ("unknown kernel", "did you mean 'rbf'?"),
        ("kernel incomplete", "kernel 'sum': expected two kernels"),
        ("bandwidths of another dimension", "rbf bandwidth: expected 1 or 2"),
        ("variance negative", "variance: expected positive"),
        ("variance unknown", "'constnt'"),
        ("no dimensions", "dimensions: expected at least 1"),
    ],
)
def test_a_refused_policy_leaves_the_old_one_serving(node: Process, probe: Probe, name: str, reason: str) -> None:
    response = probe.ask("set_policy", spoil(name))
    assert not response.accepted
    assert reason in response.message
    assert response.version == 1
    version, actions = answer(probe, observation(0))
    assert version == 1
    np.testing.assert_array_equal(actions, expected(policy(0), 0))


def test_a_saved_policy_is_served_alone_without_noise(start: Start, probe: Probe, tmp_path: Path) -> None:
    save_policy(tmp_path / "policy.npz", policy(2), Task("rkhs/Pendulum-v0", {}, 4, 0.99))
    start("policy", "--ros-args", "-p", f"policy_file:={tmp_path / 'policy.npz'}")
    probe.meet("action")
    for step in range(2):
        np.testing.assert_array_equal(answer(probe, observation(step))[1], policy(2).mean(SEEN))
    response = probe.ask("set_policy", set_policy_request(policy(0), 1))
    assert not response.accepted
    assert "file" in response.message
