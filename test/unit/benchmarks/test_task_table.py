"""The table of tasks in benchmarks/: its searches, their costs, and the stored and printed curves."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.spaces import Box

import tasks
from rkhs_ros.runs.config import config_for
from task_learners import LEARNERS, Learner
from trial import Point, Trial

STEPS = 3  # per episode
RIVALS = ("linear-cma-es", "linear-ars")


class Quadratic(gymnasium.Env[Any, Any]):
    """A task whose cost is the squared distance to an action that is linear in the observation."""

    observation_space = Box(-np.inf, np.inf, (2,), np.float64)
    action_space = Box(-2.0, 2.0, (1,), np.float64)

    def reset(self, *, seed: int | None = None, options: Any = None) -> tuple[Any, dict[str, Any]]:
        super().reset(seed=seed)
        self._step = 0
        return self._observed(), {}

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        best = 0.3 + self._seen @ [0.05, -0.4]
        self._step += 1
        return self._observed(), -float((action[0] - best) ** 2), self._step == STEPS, False, {}

    def _observed(self) -> Any:
        self._seen = self.np_random.normal([10.0, 0.0], [10.0, 1.0])
        return self._seen


@pytest.fixture
def quadratic() -> Iterator[str]:
    gymnasium.register("Quadratic-v0", Quadratic)
    yield "Quadratic-v0"
    del gymnasium.registry["Quadratic-v0"]


def curve_of(learner: str, environment: str, episodes: int, *changes: str) -> list[Point]:
    config = config_for(environment, None, [*changes, *LEARNERS[learner].changes])
    return list(LEARNERS[learner].learn(Trial(config, episodes, discounted=False)))


@pytest.mark.parametrize("learner", RIVALS)
def test_a_linear_policy_learns_a_linear_task(learner: str, quadratic: str) -> None:
    curve = curve_of(learner, quadratic, 200, f"horizon={STEPS}")
    assert curve[-1].undiscounted_return > 0.3 * curve[0].undiscounted_return  # returns are negative


@pytest.mark.parametrize(("learner", "generation"), [("linear-ars", 16), ("linear-cma-es", 7), ("no-model", 5)])
def test_every_exploring_episode_counts_and_no_other(learner: str, generation: int, quadratic: str) -> None:
    curve = curve_of(learner, quadratic, 2 * generation + 1, "horizon=9", "evaluation_episodes=4")
    assert [point.episodes for point in curve] == [generation, 2 * generation, 3 * generation]
    assert [point.steps for point in curve] == [STEPS * point.episodes for point in curve]


class Counted:
    """A learner with given curves that is interrupted once."""

    def __init__(self, interrupted_at: int) -> None:
        self.seeds: list[int] = []
        self._interrupted_at = interrupted_at

    def __call__(self, trial: Trial) -> list[Point]:
        seed = trial.config.training.seed
        if len(self.seeds) == self._interrupted_at:
            self._interrupted_at = -1
            raise KeyboardInterrupt
        self.seeds.append(seed)
        return [Point(10, 200, 0.1, 15.0 + seed, 14.0 + seed)]


@pytest.fixture
def counted(monkeypatch: pytest.MonkeyPatch) -> Counted:
    learn = Counted(interrupted_at=2)
    monkeypatch.setitem(LEARNERS, "counted", Learner(learn))
    return learn


def table(out: Path, *arguments: str) -> int:
    return tasks.main(["--tasks", "toy", "--seeds", "0-3", "--jobs", "1", "--quiet", "--out", str(out), *arguments])


def test_an_interrupted_table_continues(tmp_path: Path, counted: Counted, capsys: pytest.CaptureFixture[str]) -> None:
    assert table(tmp_path, "--learners", "counted") == 130
    assert "interrupted" in capsys.readouterr().err
    assert counted.seeds == [0, 1]
    assert table(tmp_path, "--learners", "counted") == 0
    assert counted.seeds == [0, 1, 2, 3]
    assert "| counted | 4 |" in (tmp_path / "table.md").read_text()
    table(tmp_path, "--learners", "counted")
    assert counted.seeds == [0, 1, 2, 3]


@pytest.mark.parametrize("name", tasks.TASKS)
def test_every_task_has_settings_that_fit(name: str) -> None:
    for learner in LEARNERS:
        trial = tasks.TASKS[name].trial(learner, 3, None)
        assert trial.config.training.seed == 3
        assert trial.episodes >= 100
    assert tasks.TASKS["toy"].trial("ours", 0, None).config.training.horizon == 20
