"""Attempts at one-step tasks are plotted."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.spaces import Box

from rkhs_ros.learning.algorithms.registry import ALGORITHMS
from rkhs_ros.pictures.run_pictures import draw_run
from rkhs_ros.rollouts.inline_runner import InlineRunner
from rkhs_ros.rollouts.simulation import Simulation
from rkhs_ros.runs.config import Config, Environment
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


def test_the_newest_attempts_are_drawn(tmp_path: Path, runner: InlineRunner, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = run_training(CONFIG, runner, tmp_path / "run", quiet=True)
    all_of_them = draw_run(folder)[1].read_bytes()
    monkeypatch.setattr("rkhs_ros.pictures.run_pictures.MOST_ATTEMPTS", 7)
    assert draw_run(folder)[1].read_bytes() != all_of_them
