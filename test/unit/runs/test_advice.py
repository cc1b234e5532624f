"""Advice of a run in its folder, its callback and on the page."""

from dataclasses import replace
from pathlib import Path

import gymnasium
import numpy as np
import pytest

import sim_nodes.envs  # noqa: F401  # registers the task
from rkhs_ros.learning.diagnosis import SIGNS
from rkhs_ros.rollouts.inline_runner import InlineRunner
from rkhs_ros.rollouts.simulation import Simulation
from rkhs_ros.runs.config import Config, Environment
from rkhs_ros.runs.report import advice_in
from rkhs_ros.runs.run import run_training
from rkhs_ros.view.page import status
from rkhs_ros.view.recorded import FINISHED, Recorded
from test.unit.conftest import model_free

CONSTANT = SIGNS[0][1]  # the reward has not changed
TRAINING = model_free(name="silent", iterations=4, episodes_per_iteration=2, evaluation_episodes=1, horizon=4)
CONFIG = Config(Environment("rkhs/Toy-v0", {}), TRAINING)


def silent() -> gymnasium.Env[np.ndarray, np.ndarray]:
    return gymnasium.wrappers.TransformReward(gymnasium.make("rkhs/Toy-v0"), lambda reward: 0.0)


def runner() -> InlineRunner:
    return InlineRunner(Simulation(silent))


def test_a_run_stores_its_advice_once_and_the_page_shows_it(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    begun = replace(CONFIG, training=replace(TRAINING, iterations=2))  # fewer than the advice needs
    folder = run_training(begun, runner(), tmp_path / "run", quiet=True)
    assert not advice_in(folder)
    run_training(CONFIG, runner(), folder, resume=True)
    assert advice_in(folder) == [str(CONSTANT)]
    assert capsys.readouterr().err.count(str(CONSTANT)) == 1
    longer = replace(CONFIG, training=replace(TRAINING, iterations=8))
    run_training(longer, runner(), folder, resume=True)
    assert advice_in(folder) == [str(CONSTANT)]
    assert str(CONSTANT) not in capsys.readouterr().err
    assert str(CONSTANT) in status(Recorded(folder), FINISHED)
