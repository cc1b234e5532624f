"""Policies that map single observations or batches to actions."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from rkhs_ros.policies.gaussian import Acting, GaussianPolicy
from rkhs_ros.policies.inputs import Inputs
from rkhs_ros.policies.policy import Policy, load
from rkhs_ros.policies.spaces import Spaces
from rkhs_ros.policies.storage import Task, save_policy
from rkhs_ros.policies.streams import Batch
from rkhs_ros.policies.variance import ConstantVariance
from rkhs_ros.rkhs.function import Function
from rkhs_ros.rkhs.kernels import RBF
from test.unit.conftest import random_policy

TASK = Task("Pendulum-v1", {}, 20, 0.99)
BOUNDS = np.full((1, 2), 0.4, np.float32)


def over(history: int, rng: np.random.Generator, repeat: int = 1) -> GaussianPolicy:
    """Return a policy with three observed numbers, one of them an angle, and two actions."""
    inputs = Inputs(history=history, angles=(1.0,))
    size = inputs.dimension(3, 2)
    mean = Function(RBF((2.0,)), rng.normal(size=(6, size)), rng.normal(size=(6, 2)))
    return GaussianPolicy(mean, ConstantVariance(np.ones(2)), inputs, action_repeat=repeat)


@pytest.mark.parametrize(("history", "repeat"), [(1, 1), (2, 1), (5, 1), (1, 3), (3, 5)])
@pytest.mark.parametrize("rows", [1, 4])
def test_it_acts_like_the_policy_in_a_batch(rng: np.random.Generator, history: int, repeat: int, rows: int) -> None:
    gaussian = over(history, rng, repeat)
    policy = Policy(gaussian, TASK, Spaces((3,), -BOUNDS, BOUNDS))
    observations = rng.normal(size=(rows, 12, 3))
    for _ in range(2):  # the second time after a reset
        acting = Acting(gaussian, Batch(0, 0, rows, 12, explore=False), explore=False)
        policy.reset()
        for step in range(12):
            expected = np.clip(acting(step, observations[:, step]), -0.4, 0.4).astype(np.float32)
            got = policy(observations[0, step] if rows == 1 else observations[:, step])
            assert got.dtype == np.float32
            assert got.tobytes() == expected.tobytes()
            assert got.shape == ((1, 2) if rows == 1 else (rows, 1, 2))


def test_wrong_shapes_and_non_finite_observations_are_rejected(rng: np.random.Generator) -> None:
    policy = Policy(over(2, rng), TASK, Spaces((3,), -BOUNDS, BOUNDS))
    for wrong in (np.zeros(2), np.zeros((4, 2)), np.zeros((2, 2, 3)), 0.0):
        with pytest.raises(ValueError, match=r"observation: expected the shape \(3,\) or a batch of it, got"):
            policy(wrong)
    with pytest.raises(ValueError, match="observation: expected finite numbers"):
        policy([0.0, np.nan, 0.0])
    policy(np.zeros((4, 3)))
    with pytest.raises(ValueError, match=r"observation: expected a batch of 4 as before, or reset\(\) .*, got 1"):
        policy(np.zeros(3))
    policy.reset()
    policy(np.zeros(3))
    holding = Policy(over(1, rng, 2), TASK, Spaces((3,), -BOUNDS, BOUNDS))
    holding(np.zeros(3))
    with pytest.raises(ValueError, match="expected a batch of 1 as before"):
        holding(np.zeros((2, 3)))


def test_it_is_saved_with_its_bounds_and_loaded(tmp_path: Path, rng: np.random.Generator) -> None:
    policy = Policy(over(2, rng), TASK, Spaces((3,), -BOUNDS, BOUNDS))
    policy.save(tmp_path / "p.npz")
    back = load(str(tmp_path / "p.npz"))
    assert back.task == TASK
    assert back.spaces.action_low.dtype == np.float32
    x = rng.normal(size=3)
    assert np.array_equal(back(x), policy(x))


def test_a_file_without_spaces_loads_with_unbounded_spaces(tmp_path: Path, rng: np.random.Generator) -> None:
    save_policy(tmp_path / "old.npz", random_policy(rng, d=2, n=1), TASK)
    assert load(tmp_path / "old.npz")(np.zeros(2)).shape == (1,)
    save_policy(tmp_path / "window.npz", replace(random_policy(rng, d=4, n=2), inputs=Inputs(history=3)), TASK)
    with pytest.raises(ValueError, match="policy: expected one from"):
        load(tmp_path / "window.npz")


SPACES = Spaces((1,), np.array([-1.0, 0.0, 2.0, -np.inf]), np.array([3.0, 3.4e38, 2.0, np.inf]))


def test_actions_are_clipped_to_their_bounds_and_infinite_ranges_have_half_range_1_and_middle_0() -> None:
    far = np.array([[-9.0, -9.0, -9.0, -9.0], [9.0, 9.0, 9.0, 9.0], [1.0, 1.0, 2.0, 1.0]])
    assert SPACES.clip(far).tolist() == [[-1.0, 0.0, 2.0, -9.0], [3.0, 9.0, 2.0, 9.0], [1.0, 1.0, 2.0, 1.0]]
    assert SPACES.half_ranges.tolist() == [2.0, 1.0, 1.0, 1.0]
    assert SPACES.middle == (1.0, 0.0, 2.0, 0.0)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"observation_shape": (-1,)}, "observation_shape: expected whole numbers >= 0"),
        ({"action_low": np.zeros(2, int)}, "action_low: expected real numbers"),
        ({"action_high": np.ones(3)}, "action_high: expected the shape and type of action_low"),
        ({"action_low": np.array([0.0, 1.5])}, "action_low: expected at most action_high"),
        ({"action_names": ("one",)}, "action_names: expected 2 names or none, got one"),
    ],
)
def test_invalid_spaces_are_rejected(changes: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        replace(Spaces((1,), np.zeros(2), np.ones(2)), **changes)
