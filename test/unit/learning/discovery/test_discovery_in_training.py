"""Training changes the policy's inputs when the data reveal angles or hidden states."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.spaces import Box
from gymnasium.wrappers import TransformObservation

import rkhs_ros
from rkhs_ros.base.settings import build
from rkhs_ros.learning.iteration import Iteration
from rkhs_ros.learning.state import first_state
from rkhs_ros.learning.training import train
from rkhs_ros.learning.training_settings import Training
from rkhs_ros.policies.inputs import Inputs
from rkhs_ros.policies.storage import load_policy
from rkhs_ros.rollouts.inline_runner import InlineRunner
from rkhs_ros.rollouts.simulation import Simulation
from rkhs_ros.runs.config import Config, Environment
from rkhs_ros.runs.run import run_training
from test.unit.runs import stopping
from test.unit.runs.test_resume import results

PENDULUM = "rkhs/Pendulum-v0"
WRAP = Environment(PENDULUM, {"angle": "wrap"})
MODEL = {"form": "gaussian_process", "updates": 3, "rollouts": 5, "centres": 30}
TREE: dict[str, Any] = {
    "iterations": 3,
    "episodes_per_iteration": 2,
    "evaluation_episodes": 1,
    "horizon": 60,
    "exploration_sd": "range",
    "algorithm": {"name": "rkhs_nac", "centres": 30},
    "model": MODEL,
}
ANGLE = {"angles": (0.0,), "turns": (2.0 * np.pi,)}


def learn(training: Training, state: Any = None) -> list[Iteration]:
    return list(train(training, InlineRunner(Simulation(PENDULUM, WRAP.options)), state))


def training_with(**model: Any) -> Training:
    return build(Training, {**TREE, "model": {**MODEL, **model}})


@pytest.mark.parametrize("discovery", ["none", "all"])
def test_the_wrapped_angle_of_the_pendulum_becomes_an_input(discovery: str) -> None:
    for iteration in learn(training_with(discovery=discovery)):
        inputs = iteration.policy.inputs
        assert inputs == (Inputs() if discovery == "none" else Inputs(**ANGLE))
        assert iteration.policy.mean.input_dim == (2 if discovery == "none" else 3)


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        ({"kernel": {"form": "monomials", "degree": 2}}, Inputs(degree=2)),
        ({"algorithm": {"name": "enac", "grid": [-4.0, 4.0, 3, -9.0, 9.0, 4]}}, Inputs()),
        ({"kernel": {"bandwidth": [1.0, 4.0]}}, Inputs()),
        ({"kernel": {"bandwidth": [2.0]}}, Inputs(**ANGLE)),
    ],
)
def test_monomials_grids_and_bandwidths_per_input_keep_the_inputs(changes: dict[str, Any], expected: Inputs) -> None:
    assert learn(build(Training, {**TREE, "iterations": 2, **changes}))[-1].policy.inputs == expected


def test_a_given_kernel_keeps_the_inputs() -> None:
    small = rkhs_ros.ModelBased(updates=2, rollouts=3, centres=20)
    options = {"iterations": 2, "horizon": 60, "evaluate_every": 0, "progress": False, "model": small}
    result = rkhs_ros.train(lambda: gymnasium.make(PENDULUM, angle="wrap"), kernel=rkhs_ros.RBF((1.0, 4.0)), **options)
    assert result.policy.gaussian.inputs == Inputs()


def test_an_initial_policy_brings_the_inputs_that_were_found() -> None:
    training = training_with()
    spaces = Simulation(PENDULUM).spaces
    *_, last = learn(training)
    given = last.policy
    assert first_state(training, spaces, given).policy.inputs == given.inputs == Inputs(**ANGLE)
    radians = replace(training, inputs=Inputs(angles=(0.0,)))
    assert first_state(radians, spaces, given).policy.mean is given.mean
    for wrong in (training_with(discovery="none"), replace(training, inputs=Inputs(angles=(0.0,), turns=(360.0,)))):
        with pytest.raises(ValueError, match=r"^inputs: expected [^\n]+ like the initial policy, got"):
            first_state(wrong, spaces, given)


class Stopping(stopping.Stopping):
    environment = WRAP


def test_a_run_whose_inputs_change_resumes_bit_identically(tmp_path: Path) -> None:
    config = Config(WRAP, build(Training, TREE))
    whole = results(run_training(config, Stopping(), tmp_path / "whole", quiet=True))
    assert load_policy(tmp_path / "whole" / "policy.npz")[0].inputs == Inputs(**ANGLE)
    for batches in (1, 4):
        folder = tmp_path / str(batches)
        with pytest.raises(KeyboardInterrupt):
            run_training(config, Stopping(batches), folder, quiet=True)
        assert results(run_training(config, Stopping(), folder, quiet=True, resume=True)) == whole


def without_velocity() -> gymnasium.Env[Any, Any]:
    return TransformObservation(gymnasium.make("Pendulum-v1"), lambda seen: seen[:2], Box(-1.0, 1.0, (2,)))


def test_a_hidden_velocity_lengthens_the_history_by_one_step() -> None:
    training = build(Training, {**TREE, "action_repeat": 1, "model": {**MODEL, "centres": 40}})
    iterations = train(training, InlineRunner(Simulation(without_velocity)))
    assert [iteration.policy.inputs.history for iteration in iterations] == [2, 2, 2]
