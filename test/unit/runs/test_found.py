"""What a run found about its task, in the form of settings."""

from pathlib import Path

import numpy as np
import pytest

from rkhs_ros.learning.state import Known, settings_of
from rkhs_ros.policies.inputs import Inputs
from rkhs_ros.policies.storage import load_policy
from rkhs_ros.rollouts.inline_runner import InlineRunner
from rkhs_ros.rollouts.simulation import Simulation
from rkhs_ros.runs.config import load_config
from rkhs_ros.runs.curve import Curve
from rkhs_ros.runs.report import start_from
from rkhs_ros.runs.run import run_training

WRAP = {"angle": "wrap"}
CHANGES = (
    *("iterations=2", "episodes_per_iteration=2", "evaluation_episodes=1", "horizon=200", "action_repeat=auto"),
    *("algorithm.centres=10", "model={form: gaussian_process, discovery: all, updates: 2, rollouts: 5, centres: 20}"),
)

CONFIG_FILE = Path(__file__).parents[3] / "config" / "pendulum_wrap_model_nac.yaml"
CONFIG = load_config(CONFIG_FILE, ("inputs.angles=none", *CHANGES))


def runner() -> InlineRunner:
    return InlineRunner(Simulation("rkhs/Pendulum-v0", WRAP))


def returns(folder: Path) -> list[tuple[float, ...]]:
    return [(row.exploration_return, row.evaluation_return) for row in Curve(folder / "curve.csv").rows()]


def test_the_found_settings_repeat_the_run_and_come_with_its_policy(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    whole = run_training(CONFIG, runner(), tmp_path / "whole")
    assert ": found " in capsys.readouterr().err
    policy = load_policy(whole / "policy.npz")[0]
    found = settings_of(Known(0, CONFIG.training.inputs), Known(policy.action_repeat, policy.inputs))
    assert found
    assert load_config(whole / "config.yaml") == CONFIG
    given = run_training(load_config(whole / "config.yaml", found), runner(), tmp_path / "given", quiet=True)
    assert returns(given) == returns(whole)
    (folder := tmp_path / "run").mkdir()
    start_from(folder, CONFIG, policy, runner().spaces)
    run_training(CONFIG, runner(), folder)
    assert ": found " not in capsys.readouterr().err


@pytest.mark.parametrize(
    ("inputs", "expected"),
    [
        (Inputs(angles=(0.0, 2.0)), ["inputs.angles=[0,2]"]),
        (Inputs(angles=(1.0,), turns=(360.0,)), ["inputs.angles=[1]", "inputs.turns=[360.0]"]),
        (Inputs(angles=(0.0,), turns=(2.0 * np.pi,), history=3), ["inputs.angles=[0]", "inputs.history=3"]),
    ],
)
def test_settings_give_the_same_inputs(inputs: Inputs, expected: list[str]) -> None:
    known, found = Known(1, Inputs()), Known(4, inputs)
    assert settings_of(known, found) == ["action_repeat=4", *expected]
    training = load_config(CONFIG_FILE, ("inputs.angles=none", *settings_of(known, found))).training
    assert training.inputs.is_equivalent_to(inputs)
    assert settings_of(Known(4, training.inputs), found) == settings_of(found, found) == []
