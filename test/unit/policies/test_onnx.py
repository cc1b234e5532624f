"""ONNX graphs act like the policies that they come from."""

import subprocess
import sys
from itertools import product
from pathlib import Path

import numpy as np
import pytest

from rkhs_ros.policies.onnx_export import (
    COUNT,
    OPSET,
    TOLERANCE,
    OnnxPolicy,
    check_onnx,
    onnx_model,
    random_observations,
    state_dim,
)
from test.docs.pages import ROOT, blocks
from test.unit.policies.exported import INPUTS, KERNELS, acted, random_episode, small_policy

onnx = pytest.importorskip("onnx")
onnxruntime = pytest.importorskip("onnxruntime")
PAGE = ROOT / "docs" / "export.md"


@pytest.mark.parametrize(
    ("kernel", "inputs", "repeat"),
    [*((kernel, "monomials of a window", 1) for kernel in KERNELS), *product(["rbf"], INPUTS, [1, 3])],
)
def test_it_acts_like_the_policy(kernel: str, inputs: str, repeat: int) -> None:
    policy = small_policy(kernel, inputs, repeat)
    exported, observations = OnnxPolicy(onnx_model(policy)), random_episode()
    expected = acted(policy, observations)
    for _ in range(2):  # the second time after a reset
        exported.reset()
        got = np.concatenate([exported(observation[None]) for observation in observations])
        assert got.shape == expected.shape
        assert np.allclose(got, expected, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("inputs", ["plain", "window of angles"])
def test_the_zero_function_and_scalar_actions_are_exported(inputs: str) -> None:
    for policy in (small_policy("rbf", inputs, centres=0), small_policy("linear", inputs, 2, scalar=True)):
        count, error, seconds = check_onnx(policy, onnx_model(policy))
        assert error <= 1e-12
        assert count >= COUNT
        assert seconds > 0


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


@pytest.mark.parametrize("inputs", ["only angles", "monomials of a window"])
def test_the_observations_of_the_check_reach_the_centres(inputs: str) -> None:
    policy = small_policy("polynomial" if INPUTS[inputs].degree else "one bandwidth", inputs)
    observations = random_observations(policy)
    actions = np.stack([policy(step) for step in observations[0]])
    assert np.abs(actions).max() > 100 * TOLERANCE
    assert len(np.unique(actions)) > 100


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
