import json
from collections.abc import Callable
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from rkhs_ros.learning.episodes import Episodes
from rkhs_ros.policies.inputs import Inputs
from rkhs_ros.policies.messages import policy_message, policy_of
from rkhs_ros.policies.spaces import Spaces
from rkhs_ros.policies.storage import Task, load_policy, save_policy, unpacked
from rkhs_ros.policies.streams import Batch
from rkhs_ros.policies.variance import FunctionVariance
from rkhs_ros.recordings.definitions import Types
from rkhs_ros.recordings.messages import episodes_message, episodes_of
from rkhs_ros.rkhs.function import Function
from rkhs_ros.rkhs.kernels import RBF, Kernel, Linear, Polynomial
from test.unit.conftest import arrays_of, random_episodes, random_policy

TASK = Task("rkhs/Toy-v0", {"angle": "clip", "nested": [1, 2.5]}, 20, 0.99)
KERNELS: list[Kernel] = [
    RBF((0.1, 1 / 3)),
    Polynomial(0.25, 2),
    Linear((-0.1, 1 / 3), (0.7, 1e5)),
    RBF((1.0,)) * (Polynomial(1.0, 2) + RBF((2.0,))),
]


@pytest.mark.parametrize("kernel", KERNELS, ids=str)
@pytest.mark.parametrize(("variance", "noise"), [("constant", "pink"), ("kernel", "white"), ("function", "white")])
def test_a_saved_policy_is_bit_identical_after_loading(
    tmp_path: Path, rng: np.random.Generator, kernel: Kernel, variance: str, noise: str
) -> None:
    inputs = Inputs(history=3, angles=(1.0, 0.0), degree=2, offset=0.1, turns=(360.0, 0.1 + 0.2))
    weighing = kernel if kernel.is_positive else None
    policy = replace(
        random_policy(rng, kernel=weighing, learnt=variance == "kernel"), inputs=inputs, noise=noise, action_repeat=5
    )
    policy = policy.with_mean(replace(policy.mean, kernel=kernel))
    if variance == "function":
        g = Function(kernel, rng.normal(size=(4, 2)), rng.normal(size=(4, 2)))
        policy = replace(policy, variance=FunctionVariance(g, np.full(2, 0.1), np.full(2, 1.5)))
    save_policy(tmp_path / "policy.npz", policy, TASK)
    loaded, task = load_policy(tmp_path / "policy.npz")
    assert task == TASK
    assert loaded.mean.kernel == policy.mean.kernel
    assert (loaded.inputs, loaded.noise, loaded.action_repeat) == (inputs, noise, 5)
    assert type(loaded.variance) is type(policy.variance)
    expected, got = arrays_of(policy), arrays_of(loaded)
    assert expected.keys() == got.keys()
    assert all(expected[name].tobytes() == got[name].tobytes() for name in expected)
    x, exploration = rng.normal(size=(11, 2)), rng.standard_normal((11, 2))
    assert np.array_equal(loaded.act(x, exploration), policy.act(x, exploration))
    assert "allow_pickle" not in unpacked((tmp_path / "policy.npz").read_bytes())  # as numpy 1 stores arguments


def test_options_that_a_file_cannot_store_are_refused(tmp_path: Path, rng: np.random.Generator) -> None:
    task = replace(TASK, options={"goal": np.ones(1)})
    with pytest.raises(ValueError, match=r"^task: options: expected values of JSON, got \{'goal': array"):
        save_policy(tmp_path / "policy.npz", random_policy(rng), task)
    assert not list(tmp_path.iterdir())


def test_a_file_with_a_changed_byte_is_rejected_or_still_a_policy(tmp_path: Path, rng: np.random.Generator) -> None:
    path = tmp_path / "policy.npz"
    save_policy(path, random_policy(rng, learnt=True), TASK)
    whole = path.read_bytes()
    refused = 0
    for position in rng.choice(len(whole), 400, replace=False):
        changed = bytearray(whole)
        changed[position] ^= 1 << rng.integers(8)
        path.write_bytes(changed)
        try:
            load_policy(path)
        except ValueError as error:
            refused += 1
            assert str(path) in str(error)  # noqa: PT017
            assert "\n" not in str(error)  # noqa: PT017
    assert refused > 200


def test_arrays_with_a_too_small_header_are_rejected(tmp_path: Path, rng: np.random.Generator) -> None:
    path = tmp_path / "policy.npz"
    save_policy(path, random_policy(rng, m=5000), TASK)
    path.write_bytes(path.read_bytes().replace(b"(5000, 2)", b"(1000, 2)"))  # of both centres and weights
    with pytest.raises(ValueError, match="Bad CRC-32"):
        load_policy(path)


@pytest.mark.parametrize(
    "change",
    [
        {"schema": None},
        {"weights": np.zeros((3, 2))},
        {"kernel": np.array(["rbg"])},
        {"variance": np.array([1.0, -1.0])},
        {"task": np.array(json.dumps({"environment": "rkhs/Toy-v0"}))},
        {"task": np.array(json.dumps(asdict(TASK) | {"horizon": -1}))},
        {"centres": np.array([{}], dtype=object)},
        {"kernel_sizes": np.array([2])},
        {"inputs": np.array(json.dumps({"degree": 2.5}))},
        {"observation_shape": np.array([-1]), "action_low": np.zeros(2), "action_high": np.ones(2)},
    ],
    ids=lambda change: ", ".join(change),
)
def test_files_without_a_valid_policy_raise_a_one_line_error(
    tmp_path: Path, rng: np.random.Generator, change: dict[str, np.ndarray | None]
) -> None:
    path = tmp_path / "policy.npz"
    save_policy(path, random_policy(rng), TASK)
    with np.load(path) as file:
        arrays = {**file, **change}
    np.savez(path, **{name: array for name, array in arrays.items() if array is not None})
    with pytest.raises(ValueError, match=r"policy\.npz: expected") as refusal:
        load_policy(path)
    assert "\n" not in str(refusal.value)


ROWS, HORIZON = 3, 4


BATCH = Batch(0, 0, ROWS, HORIZON, explore=True)


@pytest.fixture
def episodes(rng: np.random.Generator) -> Episodes:
    return random_episodes(rng, random_policy(rng), ROWS, HORIZON, masked=True)


def test_episodes_survive_a_round_trip_bit_identically(episodes: Episodes) -> None:
    back = episodes_of(episodes_message(Types(), 1, 1, episodes), BATCH, Spaces.unbounded(2, 2))
    before, after = arrays_of(episodes), arrays_of(back)
    assert {name: array.tobytes() for name, array in before.items()} == {n: a.tobytes() for n, a in after.items()}


@pytest.mark.parametrize("length", [0, HORIZON + 1])
def test_an_episode_of_invalid_length_is_rejected(episodes: Episodes, length: int) -> None:
    message = episodes_message(Types(), 1, 1, episodes)
    message.lengths[-1] = length
    with pytest.raises(ValueError, match="episodes' lengths: expected 1 to 4 steps"):
        episodes_of(message, BATCH, Spaces.unbounded(2, 2))


@pytest.mark.parametrize("name", ["observations", "actions", "rewards", "final_observations"])
def test_non_finite_episodes_are_rejected(episodes: Episodes, name: str) -> None:
    message = episodes_message(Types(), 1, 1, episodes)
    getattr(message, name)[-1] = np.inf
    with pytest.raises(ValueError, match=f"episodes' {name.replace('_', ' ')}: expected finite numbers"):
        episodes_of(message, BATCH, Spaces.unbounded(2, 2))


@pytest.mark.parametrize(
    ("spoil", "error"),
    [
        (lambda p: setattr(p, "centres", p.centres[:-1]), "centres: expected rows of 2 numbers, got 9 numbers"),
        (lambda p: p.weights.__setitem__(-1, np.nan), "weights: expected finite numbers"),
        (lambda p: setattr(p.variance, "name", "constnt"), "variance: expected one of constant, kernel, function"),
        (lambda p: setattr(p, "action_repeat", 0), "action_repeat: expected 1 to 1000, got 0"),
        (lambda p: setattr(p.inputs, "turns", [360.0]), "inputs.turns: expected 0 numbers, one per angle, or none"),
    ],
)
def test_invalid_policies_are_rejected(rng: np.random.Generator, spoil: Callable[[Any], object], error: str) -> None:
    message = policy_message(Types(), random_policy(rng), 1)
    spoil(message)
    with pytest.raises(ValueError, match=error):
        policy_of(message)
