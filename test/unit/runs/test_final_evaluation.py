"""At the end of a run, the best and the last policy are compared in fresh episodes."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import rkhs_ros
from rkhs_ros.learning.algorithms.rkhs_nac import RKHSNAC
from rkhs_ros.learning.training import train
from rkhs_ros.policies.policy import load
from rkhs_ros.policies.streams import Batch
from rkhs_ros.rollouts.evaluation import BATCHES, FinalEvaluation, final_evaluation
from rkhs_ros.rollouts.inline_runner import InlineRunner
from rkhs_ros.rollouts.simulation import Simulation
from rkhs_ros.runs.config import Config, Environment
from rkhs_ros.runs.report import BEST_POLICY, FINAL_EVALUATION, summary
from rkhs_ros.runs.run import run_training
from test.unit.conftest import model_free

pytestmark = pytest.mark.usefixtures("quick_disk")
TASK = "Pendulum-v1"  # with random initial states
TRAINING = model_free(
    iterations=3, episodes_per_iteration=2, evaluation_episodes=2, horizon=20, algorithm=RKHSNAC(centres=5), seed=2
)


def run(folder: Path, *, iterations: int = 3, resume: bool = False, seed: int = 2) -> Path:
    training = replace(TRAINING, iterations=iterations, seed=seed)
    with InlineRunner(Simulation(TASK)) as runner:
        config = Config(Environment(TASK, {}), training)
        return run_training(config, runner, folder, quiet=True, resume=resume)


def test_both_policies_act_in_the_same_episodes_which_no_iteration_used() -> None:
    used: list[tuple[int, Batch]] = []
    with InlineRunner(Simulation(TASK)) as runner:
        runner.record = lambda batch, episodes, _: used.append((runner_calls, batch))
        runner_calls = 0
        first, *_, last = (iteration.policy for iteration in train(TRAINING, runner))
        runner_calls = 1
        final = final_evaluation(TRAINING, runner, first, last)
    in_run, after = ({seed for n, batch in used if n == part for seed in batch.environment_seeds()} for part in (0, 1))
    assert len(after) == len(final.best) == len(final.last) == BATCHES * TRAINING.evaluation_episodes
    assert not in_run & after
    assert not np.array_equal(final.best, final.last)


def test_the_mean_decides_and_the_line_shows_both_with_their_standard_errors() -> None:
    low, high = np.array([1.0, 2.0, 3.0, 2.0]), np.array([5.0, 6.0, 7.0, 6.0])
    assert FinalEvaluation(low, high).last_is_better
    assert not FinalEvaluation(low, low.copy()).last_is_better
    assert str(FinalEvaluation(low, high)) == (
        "best policy 2 \u00b1 0.41, last policy 6 \u00b1 0.41 in 4 fresh episodes; kept the last policy"
    )
    assert str(FinalEvaluation(low, low.copy())) == "best and last policy 2 \u00b1 0.41 in 4 fresh episodes"


def test_the_better_policy_is_kept_and_a_longer_run_continues_as_if_nothing_had_been_decided(tmp_path: Path) -> None:
    finals = ((s, (run(tmp_path / f"{s}", seed=s) / FINAL_EVALUATION).read_text()) for s in range(9))
    seed = next(s for s, final in finals if "kept the last policy" in final)  # against the choice by bounds
    short, whole = tmp_path / "short", tmp_path / "whole"
    run(short, seed=seed)
    assert (short / BEST_POLICY).read_bytes() == (short / "policy.npz").read_bytes()
    assert (short / FINAL_EVALUATION).read_text().strip() in summary(short, Config(Environment(TASK, {}), TRAINING))
    decided = (short / BEST_POLICY).read_bytes()
    run(short, seed=seed, resume=True)  # repeats the last iteration
    assert (short / BEST_POLICY).read_bytes() == decided
    run(short, iterations=5, seed=seed, resume=True)
    run(whole, iterations=5, seed=seed)
    for name in (BEST_POLICY, FINAL_EVALUATION, "policy.npz"):
        assert (short / name).read_bytes() == (whole / name).read_bytes()


def test_the_library_compares_them_with_and_without_a_folder(tmp_path: Path) -> None:
    settings = {"iterations": 3, "episodes_per_iteration": 2, "evaluation_episodes": 2, "horizon": 20, "seed": 2}
    results = [
        rkhs_ros.train(TASK, RKHSNAC(centres=5), model="none", progress=False, out=out, **settings)
        for out in (None, tmp_path / "run")
    ]
    finals = [str(result.final) for result in results]
    assert finals[0] == finals[1] == (tmp_path / "run" / FINAL_EVALUATION).read_text().strip()
    observation = np.array([0.5, 0.5, 0.1], dtype=np.float32)
    kept = load(tmp_path / "run" / BEST_POLICY)(observation)
    for result in results:
        assert finals[0] in repr(result)
        assert result.best_policy is not None
        np.testing.assert_array_equal(result.best_policy(observation), kept)
