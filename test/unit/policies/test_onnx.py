"""ONNX graphs act like the policies that they come from."""

import subprocess
import sys
from collections.abc import Callable
from itertools import product
from pathlib import Path

import numpy as np
import pytest

from rkhs_ros.policies.gaussian import GaussianPolicy
from rkhs_ros.policies.inputs import Inputs
from rkhs_ros.policies.onnx_export import COUNT, OPSET, check_onnx, exported_actions, onnx_model, state_dim
from rkhs_ros.policies.policy import Policy
from rkhs_ros.policies.spaces import Spaces
from rkhs_ros.policies.storage import Task
from rkhs_ros.policies.variance import ConstantVariance
from rkhs_ros.rkhs.function import Function
from rkhs_ros.rkhs.kernels import COMPOSITIONS, RBF, Kernel, Linear, Polynomial, kernel_from_terms
from test.docs.pages import ROOT, blocks

onnx = pytest.importorskip("onnx")
onnxruntime = pytest.importorskip("onnxruntime")
PAGE = ROOT / "docs" / "export.md"
TASK = Task("Pendulum-v1", {}, 20, 0.99)
OBSERVED, STEPS = 4, 12
# A kernel for each entry of LEAVES, made for points of a dimension.
EACH_LEAF: dict[str, Callable[[int], Kernel]] = {
    "rbf": lambda d: RBF(tuple(np.linspace(0.8, 2.0, d))),
    "polynomial": lambda d: Polynomial(0.5, 3),
    "linear": lambda d: Linear(tuple(np.linspace(-1, 1, d)), tuple(np.linspace(1, 2, d))),
}
SHORT: Callable[[int], Kernel] = lambda d: RBF((1.5,))  # noqa: E731
KERNELS: dict[str, Callable[[int], Kernel]] = {
    **EACH_LEAF,
    "one bandwidth": SHORT,
    **{
        name: lambda d, name=name: kernel_from_terms(  # type: ignore[misc]
            [*SHORT(d).terms(), *EACH_LEAF["linear"](d).terms(), *SHORT(d).terms(), (name, ()), ("sum", ())]
        )
        for name in COMPOSITIONS
    },
}
INPUTS = {
    "plain": Inputs(),
    "angles": Inputs(angles=(2.0, 0.0), turns=(360.0, 1.0)),
    "only angles": Inputs(angles=(0.0, 1.0, 2.0, 3.0)),
    "monomials": Inputs(degree=2, offset=0.7),
    "window": Inputs(history=3),
    "window of angles": Inputs(history=2, angles=(1.0,)),
    "monomials of a window": Inputs(history=2, degree=2, angles=(3.0,)),
}


def small_policy(kernel: str, inputs: str, repeat: int = 1, centres: int = 6, *, scalar: bool = False) -> Policy:
    """Return a random policy, with observations of shape (2, 2) and actions of shape (2, 1), or () if scalar."""
    rng, n = np.random.default_rng(0), 1 if scalar else 2
    points = INPUTS[inputs].unfold(rng.uniform(-1.5, 1.5, (50, 4, OBSERVED)), rng.uniform(-0.5, 0.5, (50, 4, n)))
    points = points.reshape(200, -1)
    mean = Function(KERNELS[kernel](points.shape[1]), points[:centres], rng.normal(size=(centres, n)), (0.3,) * n)
    mean = mean.scale(0.7 / max(np.abs(mean(points)).max(), 0.1))  # beyond some bounds
    shape = () if scalar else (2, 1)
    spaces = Spaces((2, 2), np.full(shape, -np.inf) if scalar else np.array([[-0.4], [-np.inf]]), np.full(shape, 0.5))
    within = INPUTS[inputs].within(spaces)
    gaussian = GaussianPolicy(mean, ConstantVariance(np.ones(n)), within, action_repeat=repeat)
    return Policy(gaussian, TASK, spaces)


def random_episode() -> np.ndarray:
    return np.random.default_rng(1).uniform(-1.5, 1.5, (STEPS, 2, 2))


def acted(policy: Policy, observations: np.ndarray) -> np.ndarray:
    policy.reset()
    return np.stack([policy(observation) for observation in observations])


@pytest.mark.parametrize(
    ("kernel", "inputs", "repeat"),
    [*((kernel, "monomials of a window", 1) for kernel in KERNELS), *product(["rbf"], INPUTS, [1, 3])],
)
def test_it_acts_like_the_policy(kernel: str, inputs: str, repeat: int) -> None:
    policy = small_policy(kernel, inputs, repeat)
    observations = random_episode()
    expected, got = acted(policy, observations), exported_actions(onnx_model(policy), observations[:, None])[:, 0]
    assert got.shape == expected.shape
    assert np.allclose(got, expected, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("inputs", ["plain", "window of angles"])
def test_the_zero_function_and_scalar_actions_are_exported(inputs: str) -> None:
    for policy in (small_policy("rbf", inputs, centres=0), small_policy("linear", inputs, 2, scalar=True)):
        count, error = check_onnx(policy, onnx_model(policy))
        assert error <= 1e-12
        assert count >= COUNT


def test_the_state_contains_the_steps_the_action_and_the_window() -> None:
    policy = small_policy("rbf", "window of angles", repeat=3)
    session = onnxruntime.InferenceSession(onnx_model(policy))
    size, first = 1 + 2 + (5 + 2), random_episode()[:1]
    assert state_dim(policy) == size
    _, state = session.run(None, {"observation": first, "state": np.zeros((1, size))})
    entry = policy.gaussian.inputs.features(first.reshape(1, -1))[0]
    assert state[0, 0] == 1
    assert np.allclose(state[0, 3:], [*entry, 0, 0])  # the first observation, before which there was no action
    steps = [state := session.run(None, {"observation": first, "state": state})[1] for _ in range(4)]
    assert [each[0, 0] for each in steps] == [2, 3, 1, 2]


def test_a_policy_without_memory_has_no_state_and_names_its_task() -> None:
    model = onnx.load_model_from_string(onnx_model(small_policy("rbf", "angles")))
    assert [value.name for value in model.graph.input] == ["observation"]
    assert [value.name for value in model.graph.output] == ["action"]
    assert {entry.key: entry.value for entry in model.metadata_props} == {"environment": "Pendulum-v1"}
    assert model.opset_import[0].version == OPSET


def test_the_check_detects_another_policy() -> None:
    policy, other = small_policy("rbf", "window"), small_policy("one bandwidth", "window")
    with pytest.raises(ValueError, match=r"policy.onnx: expected the actions of the policy within 1e-06, got"):
        check_onnx(policy, onnx_model(other))


def test_the_example_of_the_page_runs_without_rkhs_ros(tmp_path: Path) -> None:
    policy = small_policy("sum", "window", repeat=2)
    (tmp_path / "policy.onnx").write_bytes(onnx_model(policy))
    np.save(tmp_path / "observations.npy", random_episode())
    (example,) = (block.code for block in blocks(PAGE) if "import onnxruntime" in block.code)
    script = f"""
import sys
sys.modules["rkhs_ros"] = None
{example}
state, actions = start, []
for observation in np.load("observations.npy"):
    action, state = act(observation, state)
    actions.append(action)
np.save("actions.npy", actions)
"""
    subprocess.run([sys.executable, "-c", script], cwd=tmp_path, check=True)
    assert np.allclose(np.load(tmp_path / "actions.npy"), acted(policy, random_episode()), atol=1e-9)
