"""Attempts at one-step tasks are stored once and plotted."""

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.spaces import Box

from rkhs_ros.learning.algorithms.registry import ALGORITHMS
from rkhs_ros.learning.algorithms.step_rules import LineSearch
from rkhs_ros.pictures.run_pictures import draw_run
from rkhs_ros.recordings.recording import read_recording
from rkhs_ros.rollouts.inline_runner import InlineRunner
from rkhs_ros.rollouts.simulation import Simulation
from rkhs_ros.runs.attempts import ATTEMPTS
from rkhs_ros.runs.config import Config, Environment
from rkhs_ros.runs.episode_files import load_episodes
from rkhs_ros.runs.run import run_training
from test.unit.conftest import model_free

pytestmark = pytest.mark.usefixtures("quick_disk")
TRAINING = model_free(iterations=4, episodes_per_iteration=3, horizon=1, algorithm=ALGORITHMS["rkhs_power"](centres=5))
CONFIG = Config(Environment("test/Throw-v0", {}), TRAINING)


class Throw(gymnasium.Env[Any, Any]):
    """Environment with a single throw at a basket."""

    observation_space, action_space = Box(-1.0, 1.0, (1,)), Box(-1.0, 1.0, (2,))

    def reset(self, *, seed: int | None = None, options: Any = None) -> Any:
        super().reset(seed=seed)
        return self.np_random.uniform(-1.0, 1.0, 1), {}

    def step(self, action: Any) -> Any:
        return np.zeros(1), float(np.exp(-np.sum((action - 0.5) ** 2))), True, False, {}


@pytest.fixture
def runner() -> Iterator[InlineRunner]:
    gymnasium.register("test/Throw-v0", Throw)
    yield InlineRunner(Simulation("test/Throw-v0"))
    gymnasium.registry.pop("test/Throw-v0")


def test_every_attempt_is_stored_and_drawn(tmp_path: Path, runner: InlineRunner) -> None:
    folder = run_training(CONFIG, runner, tmp_path / "run", quiet=True)
    stored = load_episodes(folder / ATTEMPTS).episodes
    explored = [each.episodes for each in read_recording(folder).batches if each.batch.explore]
    np.testing.assert_array_equal(stored.actions, np.concatenate([episodes.actions for episodes in explored]))
    np.testing.assert_array_equal(stored.rewards, np.concatenate([episodes.rewards for episodes in explored]))
    with_attempts = draw_run(folder)[1].read_bytes()
    (folder / ATTEMPTS).unlink()
    assert draw_run(folder)[1].read_bytes() != with_attempts


@pytest.mark.parametrize("most", [10_000, 7])
def test_a_repeated_iteration_stores_its_attempts_once(
    tmp_path: Path, runner: InlineRunner, most: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("rkhs_ros.runs.attempts.MOST_ATTEMPTS", most)
    search = ALGORITHMS["rkhs_nac"](centres=5, step=LineSearch(choices=2))  # tries further episodes
    config = replace(CONFIG, training=replace(TRAINING, algorithm=search))
    folder = run_training(config, runner, tmp_path / "run", quiet=True)
    whole = load_episodes(folder / ATTEMPTS).episodes
    run_training(config, runner, folder, quiet=True, resume=True)  # repeats the last iteration
    stored = load_episodes(folder / ATTEMPTS).episodes
    np.testing.assert_array_equal(stored.actions, whole.actions[-len(stored) :])
    assert len(stored) == {10_000: 12, 7: 7}[most]


@pytest.mark.parametrize(
    ("damage", "left"), [(lambda path: None, 12), (lambda path: path.write_bytes(b"PK"), 6), (Path.unlink, 6)]
)
def test_a_resumed_run_stores_each_attempt_once(tmp_path: Path, runner: InlineRunner, damage: Any, left: int) -> None:
    whole = run_training(CONFIG, runner, tmp_path / "whole", quiet=True)
    first_part = replace(CONFIG, training=replace(TRAINING, iterations=2))
    run_training(first_part, runner, tmp_path / "resumed", quiet=True)
    damage(tmp_path / "resumed" / ATTEMPTS)
    run_training(CONFIG, runner, tmp_path / "resumed", quiet=True, resume=True)
    stored, all_of_them = (load_episodes(folder / ATTEMPTS).episodes for folder in (tmp_path / "resumed", whole))
    np.testing.assert_array_equal(stored.actions, all_of_them.actions[-len(stored) :])
    assert len(stored) == left
    assert (tmp_path / "resumed" / "policy.npz").read_bytes() == (whole / "policy.npz").read_bytes()
