"""A failing environment stops the run with one line that locates the error; the run can resume."""

import shutil
import sys
import warnings
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.spaces import Box
from gymnasium.vector import SyncVectorEnv

from rkhs_ros.base.endings import RunError
from rkhs_ros.base.processes import search_here
from rkhs_ros.policies.streams import Batch
from rkhs_ros.rollouts.inline_runner import InlineRunner
from rkhs_ros.rollouts.simulation import Simulation
from rkhs_ros.runs.curve import Curve
from test.unit.conftest import Result, random_policy

pytestmark = pytest.mark.slow

TASKS = Path(__file__).parents[2] / "faults" / "bad_tasks.py"
ARGUMENTS = (
    *("train", "--env", "bad_tasks:Bad-v0", "--runner", "inline", "--quiet", "--iterations", 4, "--out", "run"),
    *("--set", "episodes_per_iteration=2", "evaluation_episodes=2", "model.form=none"),
)
FAULTS = {
    "nan reward": "reward of environment 0 in step 11: expected finite numbers of at most 1e+100 in size, got nan",
    "nan observation": "observation of environment 0 in step 11: expected finite numbers of at most 1e+100 in size, "
    "got nan in column 0",
    "wrong shape": "step 11 of environment 0: expected an observation of shape (2,), got one of (3,)",
    "raise in reset": "reset of environment 0: RuntimeError: there is no way back",
    "sys.exit": "step 11 of environment 0: SystemExit: 3",
}


@pytest.fixture(autouse=True)
def module(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", list(sys.path))
    monkeypatch.delitem(sys.modules, "bad_tasks", raising=False)
    shutil.copy(TASKS, tmp_path)
    yield
    gymnasium.registry.pop("Bad-v0", None)


@pytest.mark.parametrize("fault", FAULTS)
def test_a_failing_environment_stops_the_run_and_a_repaired_one_resumes_it(
    rkhs: Callable[..., Result], fault: str
) -> None:
    code, out, err = rkhs(*ARGUMENTS, f"environment.options.fault={fault}")
    error, hint = err.splitlines()
    assert (code, out, error) == (1, "", f"error: bad_tasks:Bad-v0: {FAULTS[fault]}")
    saved = "saved: run/curve.csv, run/policy.npz; resume with: rkhs train --resume run --env bad_tasks:Bad-v0"
    assert hint == f"interrupted after 2 of 4 iterations; {saved}"
    assert len(Curve(Path("run/curve.csv")).rows()) == 2
    assert Path("run/policy.npz").is_file()
    Path("mended").touch()
    assert rkhs("train", "--resume", "run", "--runner", "inline", "--quiet").code == 0
    assert len(Curve(Path("run/curve.csv")).rows()) == 4


def test_an_infinite_action_is_reported_with_environment_and_step(rng: np.random.Generator) -> None:
    policy = random_policy(rng, d=1, n=1)
    loud = policy.with_mean(type(policy.mean)(policy.mean.kernel, policy.mean.centres, np.full((5, 1), 1e308)))
    runner = InlineRunner(Simulation("rkhs/Toy-v0"))
    with warnings.catch_warnings():
        warnings.simplefilter("error")  # a warning would add a line
        with pytest.raises(RunError, match="rkhs/Toy-v0: the policy's action in environment 0, step 1: expected "):
            runner.collect(loud, Batch(0, 0, 2, 5, explore=False))


@pytest.mark.parametrize("how", ["raise RuntimeError('no licence')", "raise GeneratorExit"])
def test_an_environment_that_cannot_be_created_is_rejected(rkhs: Callable[..., Result], how: str) -> None:
    Path("unmade.py").write_text(f"import gymnasium\ndef make():\n    {how}\ngymnasium.register('Unmade-v0', make)\n")
    result = rkhs("train", "--env", "unmade:Unmade-v0", "--runner", "inline")
    assert result.code == 2
    assert result.err.startswith("error: unmade:Unmade-v0: expected an environment that can be created, got ")
    assert result.err.count("\n") == 1


class Still(gymnasium.Env[np.ndarray, np.ndarray]):
    """Environment whose observation never changes."""

    observation_space, action_space = Box(-1.0, 1.0, (1,)), Box(-1.0, 1.0, (1,))

    def reset(self, *, seed: int | None = None, options: Any = None) -> tuple[np.ndarray, dict[str, Any]]:
        return np.zeros(1, np.float32), {}

    def step(self, action: np.ndarray) -> tuple[np.ndarray, float, bool, bool, dict[str, Any]]:
        return np.zeros(1, np.float32), 0.0, False, False, {}


@pytest.mark.parametrize("flag", ["False", [True, False]])
def test_a_flag_that_is_neither_true_nor_false_is_refused(
    monkeypatch: pytest.MonkeyPatch, rng: np.random.Generator, flag: Any
) -> None:
    monkeypatch.setattr(Still, "step", lambda self, action: (np.zeros(1, np.float32), 0.0, flag, False, {}))
    runner = InlineRunner(Simulation(Still))
    with pytest.raises(RunError, match="step 1 of environment 0: expected terminated to be True or False, got "):
        runner.collect(random_policy(rng, d=1, n=1), Batch(0, 0, 1, 5, explore=False))


@pytest.mark.parametrize("reward", ["1.5", np.datetime64("2020-01-01"), None, [1.0, 2.0]])
def test_a_reward_that_is_no_number_is_refused(monkeypatch: pytest.MonkeyPatch, reward: Any) -> None:
    monkeypatch.setattr(Still, "step", lambda self, action: (np.zeros(1, np.float32), reward, False, False, {}))
    runner = InlineRunner(Simulation(Still))
    with pytest.raises(RunError, match="step 1 of environment 0: expected reward to be a real number for each"):
        runner.collect(random_policy(np.random.default_rng(0), d=1, n=1), Batch(0, 0, 1, 5, explore=False))


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"rewards": ["a", "b"]}, "expected reward to be a real number for each environment"),
        ({"rewards": np.zeros(3)}, "expected reward to be a real number for each environment"),
        ({"ends": np.zeros(3, bool)}, "expected terminated to be True or False"),
        ({"ends": np.zeros(2)}, "expected terminated to be True or False"),
        ({"ends": [0, 0]}, None),
    ],
)
def test_values_of_a_vector_environment_are_checked(changes: dict[str, Any], message: str | None) -> None:
    class Several(SyncVectorEnv):
        def step(self, actions: Any) -> Any:
            values = {"rewards": np.zeros(2), "ends": np.zeros(2, bool), **changes}
            return np.zeros((2, 1), np.float32), values["rewards"], values["ends"], np.zeros(2, int), {}

    runner, batch = InlineRunner(Simulation(Several([Still] * 2))), Batch(0, 0, 2, 5, explore=False)
    policy = random_policy(np.random.default_rng(0), d=1, n=1)
    if message is None:
        assert not runner.collect(policy, batch).terminated.any()
        return
    with pytest.raises(RunError, match=message):
        runner.collect(policy, batch)


SELFISH = """
import gymnasium, numpy as np, os
from test.unit.rollouts.test_bad_environments import Still

class Selfish(Still):
    def __init__(self):
        self.change()
    def reset(self, *, seed=None, options=None):
        self.change()
        return super().reset()
    def change(self):
        np.seterr(all="raise")
        os.chdir("/")

np.seterr(all="raise")
gymnasium.register("Selfish-v0", Selfish, max_episode_steps=3)
"""


def test_changes_of_process_state_by_an_environment_are_undone(tmp_path: Path) -> None:
    Path("selfish.py").write_text(SELFISH)
    search_here()
    before = np.geterr()
    try:
        simulation = Simulation("selfish:Selfish-v0")
        assert Path.cwd() == tmp_path
        simulation.start(Batch(0, 0, 2, 3, explore=False))
        assert np.geterr() == before
    finally:
        np.seterr(**before)
