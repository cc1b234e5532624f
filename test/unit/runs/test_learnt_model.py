"""The model of a run in memory, the model of its folder and a fit to its real episodes are bit-identical."""

import pickle
from pathlib import Path

import numpy as np
import pytest

import rkhs_ros
from rkhs_ros.app.measure import load_model
from rkhs_ros.learning.episodes import Episodes
from rkhs_ros.learning.model.dynamics_model import DynamicsModel
from rkhs_ros.rollouts.inline_runner import InlineRunner
from rkhs_ros.rollouts.model_env import LearntModel
from rkhs_ros.rollouts.simulation import Simulation
from rkhs_ros.runs.config import config_for
from rkhs_ros.runs.run import run_training

TASK, HORIZON, REPEAT = "rkhs/Pendulum-v0", 30, 4
MODEL = rkhs_ros.ModelBased(updates=1, rollouts=4, centres=30)
CHANGES = ["iterations=3", "seed=4", f"horizon={HORIZON}", f"action_repeat={REPEAT}"]
CHANGES += ["model.updates=1", "model.rollouts=4", "model.centres=30"]


def run_in(folder: Path) -> Path:
    config = config_for(TASK, HORIZON, CHANGES)
    return run_training(config, InlineRunner(Simulation(TASK)), folder, quiet=True)


def episode_in(model: LearntModel) -> np.ndarray:
    """Return the observations and rewards of an episode with random actions."""
    environment = model.as_env()
    environment.action_space.seed(1)
    rows = [[*environment.reset(seed=2)[0], 0.0]]
    done = False
    while not done:
        observation, reward, terminated, truncated, _ = environment.step(environment.action_space.sample())
        rows.append([*observation, reward])
        done = terminated or truncated
    return np.array(rows)


def test_the_models_of_a_result_its_folder_and_its_episodes_are_bit_identical(tmp_path: Path) -> None:
    explored: list[Episodes] = []
    for result in rkhs_ros.learn(TASK, model=MODEL, iterations=3, seed=4, horizon=HORIZON, action_repeat=REPEAT):
        explored.append(result.iteration.exploration)
    loaded = load_model(run_in(tmp_path / "run"))
    assert loaded.horizon == 8  # decisions, the last of 2 steps
    assert loaded.action_repeat == REPEAT
    episode = episode_in(loaded)
    np.testing.assert_array_equal(episode_in(result.model), episode)
    np.testing.assert_array_equal(episode_in(pickle.loads(pickle.dumps(loaded))), episode)
    spaces = result.policy.spaces
    decisions = Episodes.concatenate(explored).decisions(REPEAT, result.policy.task.discount, spaces)
    oracle = DynamicsModel.fit(decisions, result.policy.gaussian.inputs, spaces, 30, centred=True)
    model = LearntModel(oracle, 8, REPEAT)
    np.testing.assert_array_equal(episode_in(model), episode)


def test_a_folder_without_a_finished_iteration_is_refused(tmp_path: Path) -> None:
    folder = run_in(tmp_path / "run")
    file = folder / "recording.mcap"
    file.write_bytes(file.read_bytes()[: file.stat().st_size // 20])
    with pytest.raises(ValueError, match=r"recording\.mcap: expected at least one finished iteration, got none$"):
        load_model(folder)
    with pytest.raises(ValueError, match="expected the folder of a run"):
        load_model(tmp_path)
