"""The table of tasks in benchmarks/."""

import re
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import gymnasium
import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from scipy.stats import mannwhitneyu

import ablation
import described
import task_learners
import task_pictures
import task_table
import tasks
from rkhs_ros.base.endings import BAD_INPUT
from rkhs_ros.policies.gaussian import GaussianPolicy
from rkhs_ros.policies.variance import ConstantVariance
from task_learners import LEARNERS
from trial import HEAD, TASKS, Key, MeteredRunner, Point, add_curves, read_curves


@pytest.mark.parametrize("name", TASKS)
def test_every_task_has_settings_that_fit(name: str) -> None:
    if not tasks.missing(TASKS[name].packages):
        for learner in LEARNERS:
            trial = tasks.trial_of(TASKS[name], learner, 3)
            assert trial.config.training.seed == 3
            assert trial.episodes == (TASKS[name].episodes if learner == "ours" else 100)
        spaces = MeteredRunner(trial).spaces
        sizes = f"{spaces.observation_dim} | {spaces.action_dim} | {trial.config.training.horizon}"
        assert f"| `{name}` | {sizes} |" in task_table.PAGE.read_text()


class Still:
    """Takes the place of a learner of Stable-Baselines3."""

    def predict(self, observation: np.ndarray, deterministic: bool) -> tuple[np.ndarray, None]:
        return np.zeros(1), None


@pytest.mark.parametrize("name", ["Pendulum-v1", "cart-pole", "ball-on-beam", "tanks", "furuta"])
def test_all_learners_are_evaluated_in_the_same_episodes(name: str) -> None:
    trial = tasks.trial_of(TASKS[name], "ours", 7)
    runner, inputs = MeteredRunner(trial), trial.config.training.inputs
    size = inputs.dimension(runner.spaces.observation_dim, 1)
    mean = replace(task_learners.linear(np.zeros(1 + size), np.zeros((0, size)), runner.spaces), bias=())
    ours = runner.collect(GaussianPolicy(mean, ConstantVariance(np.ones(1)), inputs), trial.evaluation)
    env = task_learners.world(trial)
    for number, seed in enumerate(trial.evaluation.environment_seeds()):
        rewards, observations = task_learners._episode(Still(), env, seed)
        np.testing.assert_array_equal(rewards, ours.rewards[number])
        np.testing.assert_array_equal(observations[0], ours.observations[number, 0])


def curve(returns: list[float]) -> list[Point]:
    """Return a curve with a point every two episodes of seven steps."""
    return [Point(2 * i, 14 * i, 0.5 * i, each, each, each, 0.0, 1) for i, each in enumerate(returns, 1)]


def test_curves_are_the_same_after_storing_them(tmp_path: Path) -> None:
    curves = {Key("tanks", name, seed): curve([float(seed), -5.0]) for name in ("ours", "sac") for seed in range(20)}
    with ThreadPoolExecutor(8) as pool:  # as processes that share the file
        list(pool.map(lambda item: add_curves(tmp_path / "curves.csv", dict([item])), curves.items()))
    assert read_curves(tmp_path / "curves.csv") == curves
    head, *lines = (tmp_path / "curves.csv").read_text().splitlines()
    (tmp_path / "sorted.csv").write_text("\n".join([head, *reversed(lines)]))
    with pytest.raises(ValueError, match=r"sorted.csv: expected more episodes and steps of .* in each line, got \d+"):
        read_curves(tmp_path / "sorted.csv")


@pytest.mark.parametrize(("task", "rate"), [("tanks", 1.0), ("ball-on-beam", 50.0)])
def test_a_picture_counts_episodes_and_seconds_of_experience(task: str, rate: float) -> None:
    cell = task_table.Cell(tasks.TASKS[task], [curve([-5.0, -1.0])])
    drawn = [panel.lines[0].get_xdata() for panel in task_pictures.picture(task, {"ours": cell}).axes]
    np.testing.assert_allclose(drawn, [[2.0, 4.0], [14.0 / rate, 28.0 / rate]])


def test_all_runs_of_a_learner_hold_actions_as_long_as_the_first_one() -> None:
    ours = {Key("tanks", "ours", seed): [Point(1, 1, 0.0, 0.0, 0.0, 0.0, 0.0, seed)] for seed in (2, 3, 5)}
    assert tasks.repeat_of(ours, "cart-pole", "sac-held") is None
    assert tasks.repeat_of(ours, "tanks", "sac-held") == 3
    held = ours | {Key("tanks", "sac-held", 0): [Point(1, 1, 0.0, 0.0, 0.0, 0.0, 0.0, 4)]}
    assert tasks.repeat_of(held, "tanks", "sac-held") == 4


@given(st.lists(st.floats(0.0, 60.0), min_size=1, max_size=12))
def test_a_threshold_is_reached_at_the_first_point_that_is_not_below_it(returns: list[float]) -> None:
    cell = task_table.Cell(TASKS["cart-pole"], [curve(returns)])
    until = [count for count, each in zip(range(2, 99, 2), returns, strict=False) if each >= 45.0]
    assert cell.until(45.0, "episodes").value == min(until, default=np.inf)
    assert cell.until(45.0, "steps").value == 7 * min(until, default=np.inf)
    np.testing.assert_equal(cell.after(10), [returns[4] if len(returns) > 4 else np.nan])
    if until:
        later = returns[until[0] // 2 :]
        assert cell.below(45.0) == (f"{np.mean(np.array(later) < 45.0):.0%}" if later else "-")


def test_the_table_counts_seeds_that_never_reach_a_threshold() -> None:
    curves = {Key("cart-pole", "sac", seed): curve([10.0, 46.0 if seed < 1 else 3.0]) for seed in range(3)}
    cell = task_table.cells_of(curves)["cart-pole"]["sac"]
    assert cell.shown() == "never [4, never] (1 of 3)"


SCORES = st.lists(st.integers(0, 5), min_size=2, max_size=6).map(lambda scores: np.array(scores, float))


@given(st.lists(st.tuples(SCORES, SCORES), min_size=1, max_size=3))
@settings(max_examples=20, deadline=None)
def test_the_probability_of_improvement_is_the_mean_over_tasks_of_mann_whitneys_statistic(
    pairs: list[tuple[np.ndarray, np.ndarray]],
) -> None:
    found = task_table.improvement(*zip(*pairs, strict=True))
    expected = np.mean([mannwhitneyu(ours, theirs).statistic / (len(ours) * len(theirs)) for ours, theirs in pairs])
    assert found.value == pytest.approx(expected)
    assert found.low <= found.value <= found.high
    reverse = task_table.improvement(*zip(*(pair[::-1] for pair in pairs), strict=True))
    assert reverse.value == pytest.approx(1.0 - expected)


def test_a_profile_weighs_tasks_equally_and_never_counts_runs_that_did_not_end() -> None:
    found = task_table.profile([np.array([2.0, 4.0, np.inf, np.inf]), np.array([3.0])], np.array([1.0, 2.0, 3.0, 9.0]))
    assert found.value.tolist() == [0.0, 0.125, 0.625, 0.75]
    assert found.low[3] == 0.5  # the run of the second task, and none of the first
    assert found.high[3] == 1.0


@pytest.mark.parametrize("text", ["my notes\n", "", "\xff\n", ",".join(HEAD) + "\n<<<<<<< HEAD\n"])
def test_a_file_of_other_content_is_not_overwritten(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], text: str
) -> None:
    (tmp_path / "mine.csv").write_text(text, encoding="latin-1")
    assert tasks.main(["--curves", str(tmp_path / "mine.csv")]) == BAD_INPUT
    assert re.match(r"error: .*mine\.csv.*: expected .*, got .*\n$", capsys.readouterr().err)
    assert (tmp_path / "mine.csv").read_text(encoding="latin-1") == text


@pytest.mark.parametrize("task", described.SUBJECTS)
def test_a_description_changes_neither_the_physics_nor_the_reward(task: str) -> None:
    subject, rewards = described.SUBJECTS[task], {}
    for name, how in described.DESCRIPTIONS.items():
        if how.applies(subject) and not how.rate:
            env = gymnasium.make(described.name_of(task, name))
            assert env.reset(seed=7)[0] in env.observation_space
            actions = np.linspace(-1.0, 1.0, subject.steps)[:, None]
            steps = [env.step(each) for each in actions]
            assert [each[3] for each in steps] == [False] * (subject.steps - 1) + [True]
            rewards[name] = [(float(each[1]) - how.offset) / how.factor for each in steps]
    assert len(rewards) == 15
    for each in rewards.values():
        np.testing.assert_allclose(each, rewards["as-written"], rtol=1e-9)


def test_a_part_is_judged_on_the_seeds_that_ran_with_it_and_without_it() -> None:
    returns = {"all": [46.0, 3.0, 3.0], "walls": [3.0, 46.0]}
    curves = {
        Key("cart-pole", part, seed): curve([each]) for part, its in returns.items() for seed, each in enumerate(its)
    }
    assert ablation.gains(curves, "mean return")["walls"].value == 0.5
