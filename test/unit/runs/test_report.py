import csv
from dataclasses import replace
from math import inf, nan
from pathlib import Path

import numpy as np
import pytest

from rkhs_ros.learning.iteration import Row, with_error
from rkhs_ros.learning.training import train
from rkhs_ros.policies.storage import load_policy
from rkhs_ros.rollouts.inline_runner import InlineRunner
from rkhs_ros.rollouts.simulation import Simulation
from rkhs_ros.runs.config import Config, Environment, load_config
from rkhs_ros.runs.curve import BEGINNING, Curve
from rkhs_ros.runs.report import Report, evaluation_bounds, summary
from rkhs_ros.runs.run import run_training
from test.unit.conftest import arrays_of, model_free

TRAINING = model_free(name="short", iterations=2, episodes_per_iteration=3, evaluation_episodes=2, horizon=8)
CONFIG = Config(Environment("rkhs/Toy-v0", {}), TRAINING)
COLUMNS = (
    "iteration episodes steps evaluation_episodes exploration_return exploration_return_sd evaluation_return "
    "evaluation_return_sd undiscounted_exploration_return undiscounted_evaluation_return centres step_size kl "
    "sparsification_error model_return model_error seconds"
)


@pytest.fixture
def runner() -> InlineRunner:
    return InlineRunner(Simulation("rkhs/Toy-v0"))


def test_a_run_writes_its_curve_and_policy(tmp_path: Path, runner: InlineRunner) -> None:
    folder = run_training(CONFIG, runner, tmp_path / "run", quiet=True)
    assert load_config(folder / "config.yaml") == CONFIG

    iterations = list(train(TRAINING, runner))
    with (folder / "curve.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert " ".join(rows[0]) == COLUMNS
    for iteration, row in zip(iterations, rows, strict=True):
        assert int(row["iteration"]) == iteration.number
        assert int(row["episodes"]) == 3 * iteration.number
        assert int(row["steps"]) == 3 * 8 * iteration.number
        assert float(row["exploration_return"]) == iteration.exploration_returns.mean()
        assert float(row["exploration_return_sd"]) == iteration.exploration_returns.std()
        assert float(row["evaluation_return"]) == iteration.evaluation_returns.mean()
        assert float(row["evaluation_return_sd"]) == iteration.evaluation_returns.std()
        for kind, episodes in (("exploration", iteration.exploration), ("evaluation", iteration.evaluation)):
            totals = [float(rewards.sum()) for rewards in episodes.rewards]
            assert float(row[f"undiscounted_{kind}_return"]) == pytest.approx(np.mean(totals), rel=1e-12)
        assert int(row["centres"]) == iteration.metrics.centres
        assert float(row["step_size"]) == iteration.metrics.step_size
        assert float(row["kl"]) == iteration.metrics.kl
        assert float(row["sparsification_error"]) == iteration.metrics.sparsification_error
    assert 0 < float(rows[0]["seconds"]) <= float(rows[1]["seconds"])

    policy, task = load_policy(folder / "policy.npz")
    assert task == CONFIG.task
    saved, learnt = arrays_of(policy), arrays_of(iterations[-1].policy)
    assert all(saved[name].tobytes() == learnt[name].tobytes() for name in learnt)


def row(evaluated: int, value: float, sd: float) -> Row:
    return BEGINNING._replace(evaluation_episodes=evaluated, evaluation_return=value, evaluation_return_sd=sd)


def test_a_mean_is_shown_with_its_standard_error_unless_that_is_negligible() -> None:
    assert [with_error(-57.36, error) for error in (1.0, 123.4, 1e-3)] == [
        "-57.36 \u00b1 1",
        "-57.36 \u00b1 120",
        "-57.36",
    ]


@pytest.mark.parametrize("every", [0, 1])
def test_the_summary_gives_returns_of_one_kind(tmp_path: Path, runner: InlineRunner, every: int) -> None:
    config = replace(CONFIG, training=replace(TRAINING, evaluate_every=every, evaluation_episodes=5))
    folder = run_training(config, runner, tmp_path / "run", quiet=True)
    first, last = Curve(folder / "curve.csv").rows()
    returns = f"{first.exploration_return:.4g} in the first iteration, {last.exploration_return:.4g} in the last"
    if every:
        shown = [with_error(each.evaluation_return, each.evaluation_return_sd / 2) for each in (first, last)]
        undiscounted = f"undiscounted {last.undiscounted_evaluation_return:.4g}"
        returns = f"{shown[0]} after episode 3, {shown[1]} after episode 6 ({undiscounted})"
        best = max((0, 1), key=evaluation_bounds([first, last]).__getitem__)
        returns += f", at best {shown[best]} after episode {3 * (best + 1)}"
    assert f"Discounted return: {returns}" in summary(folder, config)


def test_lines_give_the_bounds_of_their_own_episodes() -> None:
    rows = [row(0, nan, nan), row(1, 4.0, 0.0), row(1, nan, nan), row(6, 5.0, 4.0)]
    assert evaluation_bounds(rows) == [-inf, 4.0, -inf, 5.0 - 4.0 / 2]


def test_a_greater_mean_of_luckier_episodes_does_not_replace_the_best_policy(
    tmp_path: Path, runner: InlineRunner
) -> None:
    report = Report(tmp_path, CONFIG, runner.spaces)
    first, second = train(TRAINING, runner)
    for iteration, returns in ((first, [1.0, 1.0]), (second, [0.0, 3.0])):  # bounds of 1 and 0
        report.add(replace(iteration, evaluation_returns=np.array(returns)))
    assert report.best_policy is first.policy
