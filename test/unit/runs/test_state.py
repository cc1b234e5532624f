"""The state of a run, as its recording contains it."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from rkhs_ros.base.settings import build
from rkhs_ros.learning.algorithms.function_spaces import Grid
from rkhs_ros.learning.algorithms.registry import ALGORITHMS
from rkhs_ros.learning.training import train
from rkhs_ros.learning.training_settings import Training
from rkhs_ros.policies.inputs import Inputs
from rkhs_ros.recordings.recorder import read_held
from rkhs_ros.recordings.recording import FILE
from rkhs_ros.rollouts.inline_runner import InlineRunner
from rkhs_ros.rollouts.simulation import Simulation
from rkhs_ros.runs.config import Config, Environment
from rkhs_ros.runs.recorded import state_of
from rkhs_ros.runs.run import run_training
from test.unit.conftest import arrays_of

TOY = InlineRunner(Simulation("rkhs/Toy-v0"))
WAYS: list[Any] = [
    *ALGORITHMS,
    {"name": "rkhs_nac", "step": {"rule": "line_search"}},
    {"name": "rkhs_nac", "exploration_decay": 0.9, "critic": "trajectory"},
    {"name": "rkhs_nac", "variance": "learnt", "reuse": 4},
    {"name": "rkhs_power", "reuse": 3},
    {"name": "rkhs_power", "variance": "as_published"},
    {"name": "power", "reuse": 3, "variance": "constant", "exploration_decay": 0.9},
    {"model": "gaussian_process"},
]
COUNTS = ("iterations", "explored", "evaluated", "steps")


def config_of(way: Any) -> Config:
    way = {"name": way} if isinstance(way, str) else dict(way)
    form = way.pop("model", "none")
    on_grid = issubclass(ALGORITHMS[way.get("name", "rkhs_nac")], Grid)
    size = {"grid": [-4.0, 4.0, 3]} if on_grid else {"centres": 6}
    tree = {
        "iterations": 4 if form == "none" else 3,
        "episodes_per_iteration": 3,
        "evaluation_episodes": 2,
        "horizon": 6,
    }
    model = {"form": form} | ({"updates": 2, "rollouts": 5, "centres": 20} if form != "none" else {})
    kernel = {"bandwidth": 4.0} if on_grid else {"form": "monomials", "degree": 2}
    parts = {"kernel": kernel, "algorithm": size | way, "model": model}
    inputs = Inputs(angles=(0.0,)) if on_grid else Inputs(history=2, angles=(0.0,), turns=(360.0,))
    return Config(Environment("rkhs/Toy-v0", {}), replace(build(Training, tree | parts), inputs=inputs))


def assert_same_bits(one: Any, other: Any) -> None:
    a, b = arrays_of(one), arrays_of(other)
    assert a.keys() == b.keys()
    for name in a:
        assert (a[name].dtype, a[name].shape, a[name].tobytes()) == (b[name].dtype, b[name].shape, b[name].tobytes())


@pytest.mark.parametrize("way", WAYS, ids=str)
def test_every_algorithm_resumes_bit_identically_from_each_iteration(tmp_path: Path, way: Any) -> None:
    config = config_of(way)
    run_training(config, TOY, tmp_path / "run", quiet=True)
    whole = list(train(config.training, TOY))
    for k, iteration in enumerate(whole[:-1], 1):
        held, _ = read_held(tmp_path / "run" / FILE, config.training.iterations, keeps_later=False)
        held.updates = held.updates[:k]
        state = state_of(held, config.training, TOY.spaces, "recording")
        assert_same_bits(state, iteration.state)
        assert all(getattr(state, name) == getattr(iteration.state, name) for name in COUNTS)
        assert state.policy.mean.kernel == iteration.state.policy.mean.kernel
        assert state.policy.inputs == iteration.state.policy.inputs
        assert state.policy.noise == iteration.state.policy.noise
        for one, other in zip(whole[k:], train(config.training, TOY, state), strict=True):
            assert_same_bits(one, other)
            assert one.metrics == other.metrics


def test_a_lost_policy_is_named(tmp_path: Path) -> None:
    config = config_of("rkhs_nac")
    run_training(config, TOY, tmp_path / "run", quiet=True)
    held, _ = read_held(tmp_path / "run" / FILE, config.training.iterations, keeps_later=False)
    del held.policies[1]
    with pytest.raises(ValueError, match=r"^recording: expected the policies .*, got none of version \[1\]$"):
        state_of(held, config.training, TOY.spaces, "recording")


def test_the_state_contains_the_memory() -> None:
    *_, last = train(config_of({"name": "power", "reuse": 3}).training, TOY)
    assert len(last.state.memory) == 3  # otherwise the test above would be vacuous
