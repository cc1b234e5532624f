"""Custom environments on the command line without a file, demonstrations, and initial policies."""

import json
import re
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from rkhs_ros.policies.policy import load
from rkhs_ros.runs.config import load_config
from rkhs_ros.runs.curve import Curve
from rkhs_ros.runs.episode_files import load_episodes
from test.unit.conftest import assert_refused

pytestmark = pytest.mark.slow

Rkhs = Callable[..., Any]
INLINE = ("--runner", "inline", "--quiet")
SHORT = ("episodes_per_iteration=3", "evaluation_episodes=2", "model.updates=2", "model.rollouts=5")
MODULE = """
import gymnasium, numpy as np
from gymnasium.spaces import Box

class Slide(gymnasium.Env):
    observation_space, action_space = Box(-2.0, 2.0, (2,)), Box(-1.0, 1.0, (1,))
    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.x = np.array([1.0, 0.0], np.float32)
        return self.x, {}
    def step(self, action):
        v = self.x[1] + 0.1 * action[0]
        self.x = np.clip(np.array([self.x[0] + 0.1 * v, v], np.float32), -2, 2)
        return self.x, float(np.exp(-4 * self.x[0] ** 2)), False, False, {}

gymnasium.register("Slide-v0", Slide, max_episode_steps=30)
gymnasium.register("Endless-v0", Slide)
"""


@pytest.fixture(autouse=True)
def module(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", list(sys.path))
    Path("my_slide.py").write_text(MODULE)


def test_an_id_is_sufficient_for_training_and_sets_the_horizon(rkhs: Rkhs) -> None:
    result = rkhs("train", "--env", "my_slide:Slide-v0", *INLINE, "--iterations", 3, "--out", "run", "--set", *SHORT)
    assert (result.code, result.err) == (0, "")
    config = load_config(Path("run/config.yaml"))
    assert config.environment.id == "my_slide:Slide-v0"
    assert (config.training.name, config.training.horizon) == ("slide_v0", 30)
    assert len(Curve(Path("run/curve.csv")).rows()) == 3
    values = json.loads(rkhs("evaluate", "run", "--episodes", 2).out)
    assert values["environment"] == "my_slide:Slide-v0"
    assert values["undiscounted"]["mean"] > values["mean"]
    policy = load("run/policy.npz")
    assert policy(np.zeros(2)).shape == (1,)


def test_without_a_time_limit_the_default_horizon_is_noted_once(rkhs: Rkhs) -> None:
    Path("endless.yaml").write_text(
        '/**/simulator: {ros__parameters: {environment: {id: "my_slide:Endless-v0"}}}\n'
        "/**/learner: {ros__parameters: {model: {form: gaussian_process}}}\n"
    )
    arguments = ("train", "endless.yaml", "--runner", "inline", "--iterations", 1)
    note = "horizon: my_slide:Endless-v0 declares no time limit; episodes end after 100 steps. Set horizon=N to change"
    assert rkhs(*arguments, "--out", "run", "--set", *SHORT).err.count(note) == 1
    assert "note:" not in rkhs(*arguments, "--out", "set", "--set", *SHORT, "horizon=7").err
    assert "note:" not in rkhs("train", "--resume", "run", "--runner", "inline", "--iterations", 2).err


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"actions": np.zeros((2, 5, 0))}, "actions: expected three dimensions: episodes, steps, components, of which"),
        ({"mask": [[True, False, True, True, True]] * 2}, "mask: expected the first steps of each episode"),
    ],
)
def test_episodes_without_actions_or_with_gaps_are_refused(
    tmp_path: Path, changes: dict[str, Any], message: str
) -> None:
    arrays = {"observations": np.zeros((2, 5, 1)), "actions": np.zeros((2, 5, 1))} | changes
    np.savez(tmp_path / "mine.npz", **arrays)
    with pytest.raises(ValueError, match=message):
        load_episodes(tmp_path / "mine.npz")


def test_a_policy_is_imitated_evaluated_and_trained_further(rkhs: Rkhs) -> None:
    train = ("train", "--env", "my_slide:Slide-v0", *INLINE, "--set", *SHORT)
    assert rkhs(*train, "--iterations", 4, "--out", "shown").code == 0
    result = rkhs("imitate", "shown", "--out", "imitated.npz", "--set", "centres=20")
    assert (result.code, result.err) == (0, "")
    (centres,) = re.findall(r"^Fitted (\d+) centres to 2 episodes with 60 steps; rms error", result.out)
    assert 0 < int(centres) <= 20
    shown, imitated = (
        json.loads(rkhs("evaluate", file, "--episodes", 1).out)["mean"] for file in ("shown", "imitated.npz")
    )
    assert abs(shown - imitated) < 0.1 * shown
    assert rkhs(*train, "exploration_sd=1e-6", "--iterations", 1, "--out", "warm", "--policy", "imitated.npz").code == 0
    (row,) = Curve(Path("warm/curve.csv")).rows()
    assert abs(row.exploration_return - imitated) < 0.1 * imitated
    before = Path("warm/curve.csv").read_text().rpartition(",")[0]
    Path("warm/policy.npz").unlink()
    assert rkhs("train", "--resume", "warm", *INLINE).code == 0
    assert Path("warm/curve.csv").read_text().rpartition(",")[0] == before


def test_evaluating_imitated_episodes_requires_an_environment(rkhs: Rkhs) -> None:
    rng = np.random.default_rng(0)
    np.savez("demo.npz", observations=rng.normal(size=(2, 30, 2)), actions=rng.normal(size=(2, 30, 1)))
    assert rkhs("imitate", "demo.npz", "--env", "my_slide:Slide-v0").code == 0
    assert json.loads(rkhs("evaluate", "imitated.npz", "--episodes", 1).out)["environment"] == "my_slide:Slide-v0"
    assert load_episodes(Path("demo.npz"))[1] is None
    assert rkhs("imitate", "demo.npz", "--out", "nowhere.npz").code == 0
    assert load("nowhere.npz")(np.zeros(2)).shape == (1,)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("train", "--env", "my_slide:Xyzzy"), " is similar. Module my_slide does not register it: call gymnasium.reg"),
        (("train", "--env", "Xyzzy-v0"), " is similar. For a custom module, use MODULE:Xyzzy-v0"),
        (("imitate", "few.npz", "--env", "Pendulum-v1"), "observations: expected 3 numbers for Pendulum-v1"),
        (("evaluate", "nowhere.npz"), "expected a policy that names its environment"),
    ],
)
def test_bad_input_ends_with_one_line(rkhs: Rkhs, arguments: tuple[str, ...], message: str) -> None:
    np.savez("few.npz", observations=np.zeros((1, 5, 2)), actions=np.zeros((1, 5, 1)))
    rkhs("imitate", "few.npz", "--out", "nowhere.npz")
    assert_refused(rkhs(*arguments), message)
